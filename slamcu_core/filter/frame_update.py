"""One frame of detections through the filter: sections 4.3 and 5.2-5.4 in the order of the paper's Figure 5."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Detection, Occluder
from slamcu_core.filter import ekf, existence, weighting
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
        pose = self.particles.pose[:, None, :]
        own = self.table.kind[rows] == Kind.NEW
        points = np.empty((len(self.particles), len(rows), 2))
        points[:] = self.table.xy[rows]
        slots = self.table.slot[rows[own]]
        points[:, own] = self.particles.mean[:, slots]
        distance, bearing = self.model.polar(pose, points)
        scale = self.particles.calibration[:, 0, None]
        if self.model.has_bearing:
            predicted = np.stack([distance * (1.0 + scale), bearing + self.particles.calibration[:, 1, None]], axis=-1)
        else:
            predicted = self.model.predict(pose, points) * (1.0 + scale[..., None])
        centre = np.einsum("k,kfi->fi", weights, points)
        covariance = self.table.covariance[rows]
        covariance[own] = np.einsum("k,klij->lij", weights, self.particles.covariance[:, slots])
        jacobian = self.model.feature_jacobian(mean_pose, centre)
        mean_distance = weights @ distance
        extra = ekf.innovation_covariance(jacobian, covariance, self.calibration.measurement_variance(mean_distance))
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

    def weigh_and_update(
        self, view: View, seen: Seen, pairs: list[tuple[int, int]], usable: NDArray[np.bool_], share: float
    ) -> None:
        """Weigh the particles by usable pairs (eq. 17-19), then update new features (eq. 16) and the calibration.

        Parameters
        ----------
        pairs : (detection, column of the view) of all associated detections.
        usable : for each pair whether its feature is Normal or New (section 4.3.4).
        """
        detections = np.array([d for d, _ in pairs], dtype=np.intp)
        columns = np.array([c for _, c in pairs], dtype=np.intp)
        rows = view.rows[columns]
        own = self.table.kind[rows] == Kind.NEW
        slots = self.table.slot[rows]
        innovation = self.model.innovation(seen.measurement[detections], view.predicted[:, columns])
        jacobian = self.model.feature_jacobian(self.particles.pose[:, None, :], view.points[:, columns])
        covariance = np.empty((len(self.particles), len(pairs), 2, 2))
        covariance[:] = self.table.covariance[rows]
        covariance[:, own] = self.particles.covariance[:, slots[own]]
        noise = np.broadcast_to(seen.noise[detections], innovation.shape)
        distance = view.distance[:, columns]
        if usable.any():
            # Q = H Σ Hᵀ + R with Σ from before the update, of map features and new ones alike (errata to 17 and 18).
            # What is constant within a pass does not average out over its n looks: it counts n times.
            looks = 1.0 + self.table.looks_hit[rows[usable]]
            common = pass_variance(distance[:, usable], self.parameters)
            repeated = np.where(own[usable], 1.0, looks)
            q = ekf.innovation_covariance(
                jacobian[:, usable],
                covariance[:, usable] * repeated[:, None, None],
                noise[:, usable] + self.calibration.measurement_variance(distance[:, usable]) + looks[:, None] * common,
            )
            likelihood = weighting.robust_log_likelihood(
                weighting.gaussian_log_likelihood(innovation[:, usable], q),
                float(np.log(self.model.clutter_density)),
                self.parameters.outlier_share,
            )
            self.particles.log_weight = weighting.combine(self.particles.log_weight, likelihood, share)
        if own.any():
            self.particles.mean[:, slots[own]], self.particles.covariance[:, slots[own]] = ekf.update(
                self.particles.mean[:, slots[own]],
                self.particles.covariance[:, slots[own]],
                jacobian[:, own],
                innovation[:, own],
                noise[:, own] / share,
            )
        if self.model.has_bearing:
            mapped = usable & (self.table.kind[rows] == Kind.MAP)
            for index in np.flatnonzero(mapped):
                place = np.einsum(
                    "kij,jl,kil->ki", jacobian[:, index], self.table.covariance[rows[index]], jacobian[:, index]
                )
                self.calibration.update(
                    self.particles,
                    innovation[:, index],
                    distance[:, index],
                    seen.noise[detections[index]] / share
                    + (1.0 + self.table.looks_hit[rows[index]])
                    * (place.mean(axis=0) + pass_variance(distance[:, index], self.parameters).mean(axis=0)),
                )
