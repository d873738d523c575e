"""One frame of detections through the filter: sections 4.3 and 5.2-5.4 in the order of the paper's Figure 5."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Detection, Occluder
from slamcu_core.filter import ekf, existence, proposal, weighting
from slamcu_core.filter.association import Marginal, associate, marginalise
from slamcu_core.filter.calibration import SensorCalibration
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.models import SensorModel, occlusion_probability, visibility_probability

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class View:
    """What one sensor should see at one instant: F rows from M particles.

    `distance` (M, F) is the true range; `predicted` (M, F, 2) the measurement with each particle's calibration;
    `visible` (F,) P(visible) by field of view, `hidden` (F,) the probability of occlusion.
    """

    rows: Index
    points: Array  # (M, F, 2)
    distance: Array
    predicted: Array
    visible: Array
    hidden: Array
    marginal: Marginal


@dataclass(frozen=True, slots=True)
class Seen:
    """The detections of a frame as arrays: D measurements with variances and codes."""

    measurement: Array  # (D, 2)
    noise: Array  # (D, 2)
    feature_class: Index
    sign: Index
    value: Index
    confidence: Array

    def keep(self, which: NDArray[np.bool_]) -> Seen:
        """Return only some of the detections, (D,)."""
        if which.all():
            return self
        return Seen(*(getattr(self, item.name)[which] for item in fields(self)))


def read_detections(model: SensorModel, items: tuple[Detection, ...], names: Vocabulary) -> Seen:
    """Turn detections into arrays; raises SlamcuError if one lacks what its sensor measures."""
    measurement = np.array([model.measurement(item) for item in items], float).reshape(-1, 2)
    return Seen(
        measurement,
        model.noise(measurement),
        np.array([names.code(item.feature_class) for item in items], dtype=np.intp),
        np.array([names.code(item.sign) for item in items], dtype=np.intp),
        np.array([names.code(item.value) for item in items], dtype=np.intp),
        np.array([item.confidence for item in items], float),
    )


def pass_variance(distance: Array, parameters: FilterParameters) -> Array:
    """Return the variances (..., 2) of what is constant within a pass: a scale of range, and a bearing."""
    return np.stack(
        [(parameters.pass_range_std * distance) ** 2, np.full_like(distance, parameters.pass_bearing_std**2)], axis=-1
    )


@dataclass(frozen=True, slots=True)
class FrameUpdate:
    """The operations of one sensor's frames on the rows and particles of one drive."""

    model: SensorModel
    table: FeatureTable
    particles: Particles
    calibration: SensorCalibration
    parameters: FilterParameters

    def look(self, rows: Index, weights: Array, mean_pose: Array, occluders: tuple[Occluder, ...]) -> View:
        """Predict what the sensor should see of the given rows."""
        own = self.table.kind[rows] == Kind.NEW
        points = np.empty((len(self.particles), len(rows), 2))
        points[:] = self.table.xy[rows]
        slots = self.table.slot[rows[own]]
        points[:, own] = self.particles.mean[:, slots]
        distance, predicted = self._predict(points)
        bearing = predicted[..., 1] - self.particles.calibration[:, 1, None]
        if not self.model.has_bearing:
            _, bearing = self.model.polar(self.particles.pose[:, None, :], points)
        centre = np.einsum("k,kfi->fi", weights, points)
        covariance = self.table.covariance[rows]
        covariance[own] = np.einsum("k,klij->lij", weights, self.particles.covariance[:, slots])
        jacobian = self.model.feature_jacobian(mean_pose, centre)
        mean_distance = weights @ distance
        extra = ekf.innovation_covariance(jacobian, covariance, self.calibration.measurement_variance(mean_distance))
        by_pose = self.model.pose_jacobian(mean_pose, centre)
        extra += by_pose @ self.particles.pending_covariance() @ np.swapaxes(by_pose, -1, -2)
        marginal = marginalise(self.model, predicted, weights, extra)
        visible = visibility_probability(self.model.sensor, distance, bearing, weights)
        hidden = np.zeros(len(rows))
        if occluders:
            _, mean_bearing = self.model.polar(mean_pose, centre)
            spread = np.sqrt(marginal.covariance[:, 1, 1]) if self.model.has_bearing else np.full(len(rows), 0.01)
            hidden = occlusion_probability(occluders, mean_distance, mean_bearing, spread)
        return View(rows, points, distance, predicted, visible, hidden, marginal)

    def pre_associate(self, view: View, seen: Seen) -> tuple[Index, Array]:
        """Assign detections to features by likelihood, one to one (section 4.3.1); return columns (D,) or -1, and NIS.

        A detection read as another sign or value than the map's is not a confirmation of it, however near it is.
        """
        e, _, u = existence.masses(self.table, view.rows)
        shows = view.visible * (1.0 - view.hidden)
        log_prior = np.log(np.maximum((e + 0.5 * u) * np.maximum(shows, 0.05), 1e-3))[None, :]
        signs, values = self.table.sign[view.rows], self.table.value[view.rows]
        other_sign = (seen.sign[:, None] != signs) & (seen.sign[:, None] > 0) & (signs > 0)
        other_value = (seen.value[:, None] != values) & (seen.value[:, None] > 0) & (values > 0)
        fits = (seen.feature_class[:, None] == self.table.feature_class[view.rows]) & ~other_sign & ~other_value
        log_prior = np.where(fits, log_prior, -np.inf)
        return associate(self.model, (seen.measurement, seen.noise), view.marginal, log_prior, self.parameters.gate)

    def weigh(
        self,
        view: View,
        seen: Seen,
        pairs: list[tuple[int, int]],
        share: float,
        rng: np.random.Generator,
    ) -> None:
        """Weigh the particles by (detection, column of the view) pairs with Normal and New features (eq. 17-19).

        Leaves the poses sampled: from the motion prior, or where that pays from it conditioned on the pairs.
        """
        particles = self.particles
        if not pairs:
            particles.settle(rng)
            return
        detections, columns = _split(pairs)
        rows, points = view.rows[columns], view.points[:, columns]
        q = self._innovation_covariance(rows, points, view.distance[:, columns], seen.noise[detections])
        by_noise = None
        if particles.pending is not None:
            by_pose = self.model.pose_jacobian(particles.pose[:, None, :], points)
            by_noise = proposal.noise_jacobian(by_pose, particles.pending)
        if by_noise is not None and proposal.pays(by_noise, q):
            innovation = self.model.innovation(seen.measurement[detections], view.predicted[:, columns])
            likelihood = proposal.condition(
                particles, by_noise, innovation, q / share, gate=self.parameters.gate, rng=rng
            )
            share = 1.0
        else:
            particles.settle(rng)
            innovation = self.model.innovation(seen.measurement[detections], self._predict(points)[1])
            likelihood = weighting.gaussian_log_likelihood(innovation, q)
        floor = float(np.log(self.model.clutter_density))
        likelihood = weighting.robust_log_likelihood(likelihood, floor, self.parameters.outlier_share)
        particles.log_weight = weighting.combine(particles.log_weight, likelihood, share)

    def update_new(self, view: View, seen: Seen, pairs: list[tuple[int, int]], share: float) -> None:
        """Update the car's own finds by their detections, in every particle (eq. 16)."""
        if not pairs:
            return
        detections, columns = _split(pairs)
        particles, points = self.particles, view.points[:, columns]
        slots = self.table.slot[view.rows[columns]]
        innovation = self.model.innovation(seen.measurement[detections], self._predict(points)[1])
        particles.mean[:, slots], particles.covariance[:, slots] = ekf.update(
            particles.mean[:, slots],
            particles.covariance[:, slots],
            self.model.feature_jacobian(particles.pose[:, None, :], points),
            innovation,
            np.broadcast_to(seen.noise[detections] / share, innovation.shape),
        )

    def calibrate(self, view: View, seen: Seen, pairs: list[tuple[int, int]], share: float) -> None:
        """Learn the sensor's calibration from detections of Normal features of the map."""
        if not pairs or not self.model.has_bearing:
            return
        detections, columns = _split(pairs)
        points = view.points[:, columns]
        distance, predicted = self._predict(points)
        innovation = self.model.innovation(seen.measurement[detections], predicted)
        jacobian = self.model.feature_jacobian(self.particles.pose[:, None, :], points)
        for index, row in enumerate(view.rows[columns].tolist()):
            h = jacobian[:, index]
            place = np.einsum("kij,jl,kil->i", h, self.table.covariance[row], h) / len(h)
            common = place + pass_variance(distance[:, index], self.parameters).mean(axis=0)
            noise = seen.noise[detections[index]] / share + (1.0 + self.table.looks_hit[row]) * common
            self.calibration.update(self.particles, innovation[:, index], distance[:, index], noise)

    def _predict(self, points: Array) -> tuple[Array, Array]:
        """Return true ranges (M, F) and measurements (M, F, 2), calibrated, of points (M, F, 2)."""
        pose = self.particles.pose[:, None, :]
        scale, turn = self.particles.calibration[:, 0, None], self.particles.calibration[:, 1, None]
        distance, bearing = self.model.polar(pose, points)
        if self.model.has_bearing:
            return distance, np.stack([distance * (1.0 + scale), bearing + turn], axis=-1)
        return distance, self.model.predict(pose, points) * (1.0 + scale[..., None])

    def _innovation_covariance(self, rows: Index, points: Array, distance: Array, noise: Array) -> Array:
        """Return Q = H Σ Hᵀ + R (M, A, 2, 2) with Σ from before the update, of map and new features (errata 17, 18).

        What is constant within a pass does not average out over its n looks, so it counts n times.
        """
        own = self.table.kind[rows] == Kind.NEW
        looks = 1.0 + self.table.looks_hit[rows]
        covariance = np.empty((*points.shape, 2))
        covariance[:] = self.table.covariance[rows] * looks[:, None, None]
        covariance[:, own] = self.particles.covariance[:, self.table.slot[rows[own]]]
        jacobian = self.model.feature_jacobian(self.particles.pose[:, None, :], points)
        constant = looks[:, None] * pass_variance(distance, self.parameters)
        return ekf.innovation_covariance(
            jacobian, covariance, noise + self.calibration.measurement_variance(distance) + constant
        )


def _split(pairs: list[tuple[int, int]]) -> tuple[Index, Index]:
    both = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return both[:, 0], both[:, 1]
