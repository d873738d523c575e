"""One frame of detections through the filter: sections 4.3 and 5.2-5.4 in the order of the paper's Figure 5."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Detection, Occluder
from slamcu_core.evidence import support
from slamcu_core.filter import ekf, existence, proposal, weighting
from slamcu_core.filter.association import Marginal, associate, marginalise
from slamcu_core.filter.calibration import SensorCalibration
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.geometry import wrap_angle
from slamcu_core.models import SensorModel, Sight, occlusion_probability, visibility_probability

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class View:
    """What one sensor should see at one instant: F rows from M particles.

    `sight` is how each particle sees the points (2, F, M); `predicted` (2, F, M) the measurement with each particle's
    calibration; `pending` (3, 3) is the covariance of the poses' pending noise; `visible` (F,) P(visible) by field of
    view, `hidden` (F,) the probability of occlusion.
    """

    rows: Index
    points: Array
    sight: Sight
    predicted: Array
    pending: Array
    visible: Array
    hidden: Array
    marginal: Marginal


@dataclass(frozen=True, slots=True)
class Matches:
    """Detections matched with rows, A of them, as the particles see those rows once their poses are sampled."""

    rows: Index
    points: Array  # (2, A, M)
    sight: Sight
    measurement: Array  # (2, A)
    noise: Array  # (2, A)

    def __getitem__(self, chosen: NDArray[np.bool_]) -> Matches:
        """Return some of the matches."""
        index = (chosen).nonzero()[0]
        if len(index) == len(self.rows):
            return self
        return Matches(
            self.rows[index],
            self.points[:, index],
            self.sight[index],
            self.measurement[:, index],
            self.noise[:, index],
        )


@dataclass(frozen=True, slots=True)
class Seen:
    """The detections of a frame as arrays: D measurements with variances and codes."""

    measurement: Array  # (2, D)
    noise: Array  # (2, D)
    feature_class: Index
    sign: Index
    value: Index
    weight: Array  # of eq. 1

    @property
    def named(self) -> bool:
        """Whether the sign or value of any was read."""
        return bool(self.sign.any() or self.value.any())

    def keep(self, which: NDArray[np.bool_]) -> Seen:
        """Return only some of the detections, (D,)."""
        if which.all():
            return self
        return Seen(*(getattr(self, item.name)[..., which] for item in fields(self)))


def read_detections(model: SensorModel, items: tuple[Detection, ...], names: Vocabulary) -> Seen:
    """Turn detections into arrays; raises SlamcuError if one lacks what its sensor measures."""
    measurement = np.array([model.measurement(item) for item in items], float).reshape(-1, 2).T
    feature_class = np.array([names.code(item.feature_class) for item in items], dtype=np.intp)
    sign = value = np.zeros(len(items), dtype=np.intp)
    if any(item.sign is not None or item.value is not None for item in items):
        sign = np.array([names.code(item.sign) for item in items], dtype=np.intp)
        value = np.array([names.code(item.value) for item in items], dtype=np.intp)
    weight = support([item.confidence for item in items])
    return Seen(measurement, model.noise(measurement), feature_class, sign, value, weight)


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
        own = (self.table.kind[rows] == Kind.NEW).nonzero()[0]
        slots = self.table.slot[rows[own]]
        points = np.empty((2, len(rows), len(self.particles)))
        points[:] = self.table.xy[rows].T[:, :, None]
        points[:, own] = self.particles.means[:, slots]
        sight = self.model.sight(self.particles.pose, points)
        predicted = self._calibrated(sight)
        pending = self.particles.pending_covariance(weights)
        covariance = self.table.covariance[rows].transpose(1, 2, 0)
        covariance[:, :, own] = self.particles.covariances[:, :, slots] @ weights
        mean_distance = sight.distance @ weights
        centre = self.model.sight(mean_pose[:, None], points @ weights)
        by_pose = self.model.by_pose(centre, self.model.by_feature(centre))
        # H Σ Hᵀ of the features and of the pose's pending noise in one: by place, ∂h/∂x is -H
        spread = np.empty((3, 3, len(rows)))
        spread[:] = pending[:, :, None]
        spread[:2, :2] += covariance
        extra = ekf.innovation_covariance(by_pose, spread, self.calibration.measurement_variance(mean_distance))
        marginal = marginalise(self.model, predicted, weights, extra)
        visible = visibility_probability(self.model.sensor, sight.distance, wrap_angle(sight.bearing), weights)
        hidden = np.zeros(len(rows))
        if occluders:
            bearing_std = np.sqrt(marginal.covariance[1, 1]) if self.model.has_bearing else np.full(len(rows), 0.01)
            hidden = occlusion_probability(occluders, mean_distance, wrap_angle(centre.bearing), bearing_std)
        return View(rows, points, sight, predicted, pending, visible, hidden, marginal)

    def pre_associate(self, view: View, seen: Seen) -> tuple[Index, Array]:
        """Assign detections to features by likelihood, one to one (section 4.3.1); return columns (D,) or -1, and NIS.

        A detection read as another sign or value than the map's is not a confirmation of it, however near it is.
        """
        shows = np.maximum(view.visible * (1.0 - view.hidden), 0.05)
        log_prior = np.log(np.maximum(existence.probability(self.table, view.rows) * shows, 1e-3))
        fits = seen.feature_class[:, None] == self.table.feature_class[view.rows]
        if seen.named:
            for read, known in ((seen.sign, self.table.sign[view.rows]), (seen.value, self.table.value[view.rows])):
                fits &= (read[:, None] == known) | (read[:, None] == 0) | (known == 0)
        log_prior = np.where(fits, log_prior, -np.inf)
        return associate(self.model, (seen.measurement, seen.noise), view.marginal, log_prior, self.parameters.gate)

    def weigh(
        self, view: View, seen: Seen, matched: tuple[Index, Index], share: float, rng: np.random.Generator
    ) -> None:
        """Weigh the particles by detections of Normal and New features (eq. 17-19).

        Leaves the poses sampled: from the motion prior, or where that pays from it conditioned on the detections.
        `matched` are the detections (A,) and the columns (A,) of the view that they belong to.
        """
        particles, (detections, columns) = self.particles, matched
        if not len(columns):
            particles.settle(rng)
            return
        sight, noise = view.sight[columns], seen.noise[:, detections]
        by_feature = self.model.by_feature(sight)
        q = self._innovation_covariance(view.rows[columns], sight.distance, by_feature, noise)
        by_noise = None
        if particles.pending is not None and proposal.may_pay(
            view.pending, view.marginal.mean[0, columns], noise, self.model
        ):
            by_noise = proposal.noise_jacobian(self.model.by_pose(sight, by_feature), particles.pending)
        if by_noise is not None and proposal.pays(by_noise, np.array([q[0, 0], q[1, 1]])):
            innovation = self.model.innovation(seen.measurement[:, detections, None], view.predicted[:, columns])
            likelihood = proposal.condition(
                particles, by_noise, innovation, q / share, gate=self.parameters.gate, rng=rng
            )
            share = 1.0
        else:
            particles.settle(rng)
            innovation = self._innovation(self.match(view, seen, detections, columns))
            likelihood = weighting.gaussian_log_likelihood(innovation, q)
        likelihood = weighting.robust_log_likelihood(likelihood, self.model.log_clutter, self.parameters.outlier_share)
        particles.log_weight = weighting.combine(particles.log_weight, likelihood, share)

    def match(self, view: View, seen: Seen, detections: Index, columns: Index) -> Matches:
        """Return matches of detections (A,) with columns (A,) of the view, seen from the poses as they are now."""
        points = view.points[:, columns]
        sight = self.model.sight(self.particles.pose, points)
        return Matches(view.rows[columns], points, sight, seen.measurement[:, detections], seen.noise[:, detections])

    def update_new(self, found: Matches, share: float) -> None:
        """Update the car's own finds by their detections, in every particle (eq. 16)."""
        if not len(found.rows):
            return
        particles, slots = self.particles, self.table.slot[found.rows]
        means, covariances = ekf.update(
            found.points,
            particles.covariances[:, :, slots],
            self.model.by_feature(found.sight),
            self._innovation(found),
            found.noise[:, :, None] / share,
        )
        particles.means[:, slots], particles.covariances[:, :, slots] = means, covariances
        self.table.xy[found.rows] = means.mean(axis=-1).T  # good enough to say whether a find is within reach

    def calibrate(self, mapped: Matches, share: float) -> None:
        """Learn the sensor's calibration from detections of Normal features of the map."""
        if not len(mapped.rows) or not self.model.has_bearing:
            return
        count, sight = len(self.particles), mapped.sight
        innovation = self._innovation(mapped)
        h = self.model.by_feature(sight)
        covariance = self.table.covariance[mapped.rows].transpose(1, 2, 0)[..., None]
        place = np.add.reduce(ekf.product(h, covariance) * h, axis=(1, 3)) / count  # the diagonal of H Σ Hᵀ
        common = place
        common[0] += self.parameters.pass_range_std**2 * (
            np.add.reduce(sight.distance * sight.distance, axis=1) / count
        )
        common[1] += self.parameters.pass_bearing_std**2
        noise = mapped.noise / share + (1.0 + self.table.looks_hit[mapped.rows]) * common
        mean_range = np.add.reduce(sight.distance, axis=1) / count
        self.calibration.update(self.particles, innovation, mean_range, noise)

    def _calibrated(self, sight: Sight) -> Array:
        """Return measurements (2, F, M) as each particle's calibration makes the sensor show them."""
        scale, turn = self.particles.calibration
        if self.model.has_bearing:
            return np.array([sight.distance * (1.0 + scale), sight.bearing + turn])
        return np.asarray(sight.measurement * (1.0 + scale))

    def _innovation(self, matches: Matches) -> Array:
        return self.model.innovation(matches.measurement[:, :, None], self._calibrated(matches.sight))

    def _innovation_covariance(self, rows: Index, distance: Array, by_feature: Array, noise: Array) -> Array:
        """Return Q = H Σ Hᵀ + R (2, 2, A, M), Σ from before the update, of map and new features (errata 17, 18).

        What is constant within a pass does not average out over its n looks, so it counts n times.
        """
        table, parameters = self.table, self.parameters
        own = (table.kind[rows] == Kind.NEW).nonzero()[0]
        looks = 1.0 + table.looks_hit[rows]
        covariance = np.empty((2, 2, *distance.shape))
        covariance[:] = (table.covariance[rows].transpose(1, 2, 0) * looks)[..., None]
        covariance[:, :, own] = self.particles.covariances[:, :, table.slot[rows[own]]]
        variance = np.empty((2, *distance.shape))  # of the measurement, the calibration and the pass
        scale_variance = self.calibration.variance[0] + looks * parameters.pass_range_std**2
        variance[0] = distance * distance * scale_variance[:, None] + noise[0, :, None]
        variance[1] = (self.calibration.variance[1] + looks * parameters.pass_bearing_std**2 + noise[1])[:, None]
        return ekf.innovation_covariance(by_feature, covariance, variance)
