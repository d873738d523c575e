"""One frame of detections through the particles: sections 4.3.1 and 5.2-5.4 in the order of the paper's Figure 5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import ekf, existence, proposal, weighting
from slamcu_core.filter.association import associate
from slamcu_core.filter.calibration import SensorCalibration
from slamcu_core.filter.detections import Seen
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.filter.view import View
from slamcu_core.models import Jacobian, SensorModel, Sight

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class CloseLook(NamedTuple):
    """How each of M particles sees A rows from its pose, with its own map of the car's finds among them."""

    rows: Index
    own: Index  # which of the A are the car's own finds
    slots: Index  # of those
    looks: Array  # (A,) independent looks of the pass, this one included
    means: Array  # (2, B, M) of the finds
    sight: Sight
    by_feature: Jacobian
    by_place: Array  # (3, A, M), H Σ Hᵀ

    def pick(self, index: Index, looks: Array) -> CloseLook:
        """Return the look at some of the A rows, of which there are so many `looks` now."""
        # both in order: what is the car's own among those picked, and which of the finds it is
        find = self.own.searchsorted(index)
        own = (self.own.take(find, mode="clip") == index).nonzero()[0] if len(self.own) else self.own
        find = find[own]
        return CloseLook(
            self.rows[index],
            own,
            self.slots[find],
            looks,
            self.means.take(find, axis=1),
            self.sight.some(index),
            self.by_feature.some(index),
            self.by_place.take(index, axis=1),
        )


class Matches(NamedTuple):
    """Detections matched with rows, A of them, as the particles see those rows once their poses are sampled."""

    close: CloseLook
    measurement: Array  # (2, A)
    noise: Array  # (2, A)
    innovation: Array  # (2, A, M)


@dataclass(frozen=True, slots=True)
class FrameUpdate:
    """The operations of one sensor's frames on the rows and particles of one drive."""

    model: SensorModel
    table: FeatureTable
    particles: Particles
    calibration: SensorCalibration
    parameters: FilterParameters

    def pre_associate(self, view: View, seen: Seen, log_unknown: Array) -> tuple[Index, Array, Array]:
        """Assign detections to features by likelihood, one to one (section 4.3.1).

        Returns columns (D,) or -1, the NIS (D, C), and ln of how much likelier each is than something unknown, (D, C);
        `log_unknown` (D,) is ln of the density of that.

        A detection read as another sign or value than the map's is not a confirmation of it, however near it is.
        """
        shows = np.maximum(view.shown[: view.close], 0.05)
        likely = existence.probability(self.table, view.rows[: view.close])
        likely *= shows
        log_prior = np.log(np.maximum(likely, 1e-3, out=likely), out=likely)
        fits = self.fits(view, seen)
        if np.count_nonzero(fits) < fits.size:
            log_prior = np.where(fits, log_prior, -np.inf)
        return associate(
            self.model,
            (seen.measurement, seen.noise),
            view.marginal,
            log_prior,
            log_unknown=log_unknown,
            gate=self.parameters.gate,
        )

    def fits(self, view: View, seen: Seen) -> NDArray[np.bool_]:
        """Return which detection could be which feature by class, sign and value, (D, C)."""
        rows = view.rows[: view.close]
        fits = seen.feature_class[:, None] == self.table.feature_class[rows]
        if seen.named:
            for read, known in ((seen.sign, self.table.sign[rows]), (seen.value, self.table.value[rows])):
                fits &= (read[:, None] == known) | (read[:, None] == 0) | (known == 0)
        return np.asarray(fits)

    def log_unknown(self, seen: Seen, unmapped: float) -> Array:
        """Return ln of the density (D,) of false alarms and of unknown things, of which there are `unmapped` per m²."""
        ground = seen.measurement[0] if self.model.has_bearing else np.ones(seen.measurement.shape[1])  # m² per m·rad
        return np.asarray(np.log(self.model.clutter_density + unmapped * ground))

    def weigh(
        self,
        view: View,
        seen: Seen,
        matched: tuple[Index, Index],
        usable: NDArray[np.bool_],
        *,
        share: float,
        rng: np.random.Generator,
    ) -> Matches:
        """Weigh the particles by detections of Normal and New features (eq. 17-19), and return all matches.

        Leaves the poses sampled: from the motion prior, or where that pays from it conditioned on the detections.
        `matched` are the detections (A,) and the columns (A,) of the view that they belong to, `usable` (A,) says of
        which of them the car may localize on.
        """
        particles = self.particles
        if not np.count_nonzero(usable):
            particles.settle(rng)
            return self.match(view, seen, matched)
        if particles.pending is not None and self._conditioning_pays(view, seen, matched, usable):
            matches = self.match(view, seen, matched)
            used, close = usable.nonzero()[0], matches.close
            by_noise = proposal.noise_jacobian(self.model.by_pose(close.sight, close.by_feature), particles.pending)
            likelihood = proposal.condition(
                particles,
                by_noise[:, :, used],
                matches.innovation[:, used],
                self.innovation_covariance(close, matches.noise)[:, used] / share,
                gate=self.parameters.gate,
                rng=rng,
            )
            share = 1.0
            matches = self.match(view, seen, matched)
        else:
            particles.settle(rng)
            matches = self.match(view, seen, matched)
            q = self.innovation_covariance(matches.close, matches.noise)
            likelihood = weighting.gaussian_log_likelihood(matches.innovation, q)
            if not usable.all():
                likelihood = likelihood[usable]
        likelihood = weighting.robust_log_likelihood(likelihood, self.model.log_clutter, self.parameters.outlier_share)
        particles.log_weight = weighting.combine(particles.log_weight, likelihood, share)
        return matches

    def match(
        self, view: View, seen: Seen, matched: tuple[Index, Index], looked: tuple[Index, CloseLook] | None = None
    ) -> Matches:
        """Return the matches of detections (A,) with columns (A,) of the view, seen from the poses as they are now.

        `looked` are columns, in order, that have been examined from these poses, those matched among them.
        """
        detections, columns = matched
        if looked is None:
            close = self.examine(view, columns)
        else:
            looks = 1.0 + self.table.looks_hit[view.rows[columns]]  # a pass may have begun since
            close = looked[1].pick(looked[0].searchsorted(columns), looks)
        measurement, noise = seen.measurement.take(detections, axis=1), seen.noise.take(detections, axis=1)
        innovation = self.model.innovation(measurement[:, :, None], self.calibrated(close.sight))
        return Matches(close, measurement, noise, innovation)

    def examine(self, view: View, columns: Index) -> CloseLook:
        """Look at A columns of the view from each particle's pose as it is now."""
        table, particles, model = self.table, self.particles, self.model
        rows = view.rows[columns]
        slots = table.slot[rows]
        own = (slots >= 0).nonzero()[0]  # finds, and watch features since they were first seen
        slots = slots[own]
        means, covariances = particles.means.take(slots, axis=1), particles.covariances.take(slots, axis=1)
        place, direction = model.origin(particles.pose)
        if len(own) < len(rows):
            delta = np.empty((2, len(rows), len(particles)))
            delta[:] = table.xy.take(rows, axis=0).T[:, :, None]
            delta[:, own] = means
            delta -= place[:, None]
            covariance = np.empty((3, *delta.shape[1:]))
            covariance[:] = table.covariance.take(rows, axis=0).T[:, :, None]
            covariance[:, own] = covariances
        else:
            delta, covariance = means - place[:, None], covariances
        sight = model.sight_along(particles.pose, delta, direction)
        by_feature = model.by_feature(sight)
        looks = 1.0 + table.looks_hit[rows]
        by_place = ekf.projected(by_feature, covariance)
        return CloseLook(rows, own, slots, looks, means, sight, by_feature, by_place)

    def calibrated(self, sight: Sight) -> Array:
        """Return measurements (2, A, M) as each particle's calibration makes the sensor show them."""
        scale, turn = self.calibration.means(self.particles)
        if not self.model.has_bearing:
            return np.asarray(sight.measurement * (1.0 + scale))
        shown = np.empty((2, *sight.distance.shape))
        np.multiply(sight.distance, 1.0 + scale, out=shown[0])
        np.add(sight.bearing, turn, out=shown[1])
        return shown

    def innovation_covariance(self, close: CloseLook, noise: Array) -> Array:
        """Return Q = H Σ Hᵀ + R (3, A, M), Σ from before the update, of map and new features (errata 17, 18)."""
        distance = close.sight.distance
        often, scale_variance, turn_variance = self._over_a_pass(close.looks, close.own)
        q = close.by_place * often[:, None]
        variance = distance * distance
        variance *= scale_variance[:, None]
        variance += noise[0, :, None]
        q[0] += variance
        q[2] += (turn_variance + noise[1])[:, None]
        return q

    def _over_a_pass(self, looks: Array, own: Index) -> tuple[Array, Array, Array]:
        """Return how often a place's covariance counts (A,), and the variances (A,) of range scale and bearing bias.

        What is constant within a pass does not average out over its n looks, so it counts n times: the place of a map
        feature, but not of a find, which the looks themselves improve.
        """
        parameters, (scale_variance, turn_variance) = self.parameters, self.calibration.variance.tolist()
        often = looks.copy()
        often[own] = 1.0
        return (
            often,
            scale_variance + looks * parameters.pass_range_std**2,
            turn_variance + looks * parameters.pass_bearing_std**2,
        )

    def _conditioning_pays(
        self, view: View, seen: Seen, matched: tuple[Index, Index], usable: NDArray[np.bool_]
    ) -> bool:
        """Return whether the poses' pending noise shows in the detections, as the mean pose sees it."""
        detections, columns = matched[0][usable], matched[1][usable]
        spread, variance = view.by_motion.take(columns, axis=1), seen.noise.take(detections, axis=1)
        if not proposal.pays(spread, variance):
            return False  # by the sensor's noise alone, and there is more
        looks = 1.0 + self.table.looks_hit[view.rows[columns]]
        often, scale_variance, turn_variance = self._over_a_pass(looks, (columns >= view.mapped).nonzero()[0])
        variance = variance + view.by_place.take(columns, axis=1) * often
        variance[0] += view.marginal.mean[0, columns] ** 2 * scale_variance
        variance[1] += turn_variance
        return proposal.pays(spread, variance)

    def update_new(self, matches: Matches, share: float) -> None:
        """Update what the particles place by its detections, in every particle (eq. 16).

        Those are the car's own finds, and watch features, of which nothing but their place is estimated.
        """
        close, own = matches.close, matches.close.own
        if not len(own):
            return
        particles, sight = self.particles, close.sight.some(own)
        means, covariances = ekf.update(
            close.means,
            close.by_place.take(own, axis=1),
            close.by_feature.some(own),
            # again, for the calibration has learned since
            self.model.innovation(matches.measurement.take(own, axis=1)[:, :, None], self.calibrated(sight)),
            matches.noise.take(own, axis=1)[:, :, None] / share,
        )
        particles.means[:, close.slots], particles.covariances[:, close.slots] = means, covariances
        # good enough to say whether a find is within reach; a watch feature is looked for where the cloud has it
        rows = close.rows[own]
        found = (self.table.kind[rows] == Kind.NEW).nonzero()[0]
        if len(found) < len(rows):
            rows, means = rows[found], means.take(found, axis=1)
        self.table.xy[rows] = (means @ particles.even).T

    def calibrate(self, matches: Matches, usable: NDArray[np.bool_], share: float) -> None:
        """Learn the sensor's calibration from detections of Normal features of the map, by `usable` (A,)."""
        if not self.model.has_bearing:
            return
        chosen = usable.copy()
        chosen[matches.close.own] = False
        index = chosen.nonzero()[0]
        if not len(index):
            return
        even, distance = self.particles.even, matches.close.sight.distance
        common = matches.close.by_place[::2] @ even
        common[0] += self.parameters.pass_range_std**2 * ((distance * distance) @ even)
        common[1] += self.parameters.pass_bearing_std**2
        noise = matches.noise / share + matches.close.looks * common
        mean_range = distance @ even
        innovation = matches.innovation.take(index, axis=1)
        self.calibration.update(self.particles, innovation, mean_range[index], noise.take(index, axis=1))
