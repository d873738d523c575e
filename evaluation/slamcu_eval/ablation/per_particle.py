"""Association per particle (FastSLAM), to be compared with the filter's, which all particles share.

Existence, passes and the maps of new features go by the shared association as before, for the paper's map management
is one for all particles (section 4.3); the weights and the proposal go by each particle's own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import ekf, proposal, weighting
from slamcu_core.filter.frame_update import FrameUpdate, Seen, View
from slamcu_eval.ablation.parts import weighs_as_normal

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class PerParticle(FrameUpdate):
    """A frame update in which each particle takes every detection for the feature that fits it best from there."""

    def weigh(
        self, view: View, seen: Seen, matched: tuple[Index, Index], share: float, rng: np.random.Generator
    ) -> None:
        """Weigh the particles, each by its own association with Normal and New features (eq. 17-19)."""
        particles = self.particles
        columns = np.flatnonzero(weighs_as_normal(self.table, view.rows))
        columns = np.union1d(columns, matched[1]).astype(np.intp)
        fits = self._fits(view, seen, columns)
        detections = np.flatnonzero(fits.any(axis=1))
        if not len(detections):
            particles.settle(rng)
            return
        fits = fits[detections]
        sight = view.sight[columns]
        by_noise = None
        if particles.pending is not None:
            by_pose = self.model.by_pose(sight, self.model.by_feature(sight))
            by_noise = proposal.noise_jacobian(by_pose, particles.pending)
        open_noise = by_noise
        first = self._covariance(view, columns, seen.noise[:, detections[0]])
        if by_noise is None or not proposal.pays(by_noise, np.array([first[0, 0], first[1, 1]])):
            particles.settle(rng)
            open_noise = None
        innovation, covariance, chosen = self._choose(view, seen, detections, columns, fits=fits, by_noise=open_noise)
        if open_noise is not None:
            mine = open_noise[:, :, chosen, np.arange(len(particles))]
            likelihood = proposal.condition(
                particles, mine, innovation, covariance / share, gate=self.parameters.gate, rng=rng
            )
            share = 1.0
        else:
            likelihood = weighting.gaussian_log_likelihood(innovation, covariance)
        likelihood = weighting.robust_log_likelihood(likelihood, self.model.log_clutter, self.parameters.outlier_share)
        particles.log_weight = weighting.combine(particles.log_weight, likelihood, share)

    def _fits(self, view: View, seen: Seen, columns: Index) -> NDArray[np.bool_]:
        """Return which detection could be which column (D, C): by class and by the gate with the particles averaged."""
        rows, marginal = view.rows[columns], view.marginal
        nu = self.model.innovation(seen.measurement[:, :, None], marginal.mean[:, None, columns])
        covariance = np.repeat(marginal.covariance[:, :, None, columns], seen.measurement.shape[1], axis=2)
        covariance[0, 0] += seen.noise[0, :, None]
        covariance[1, 1] += seen.noise[1, :, None]
        inside = ekf.mahalanobis_square(nu, covariance)[0] < self.parameters.gate
        signs, values = self.table.sign[rows], self.table.value[rows]
        other = (seen.sign[:, None] != signs) & (seen.sign[:, None] > 0) & (signs > 0)
        other |= (seen.value[:, None] != values) & (seen.value[:, None] > 0) & (values > 0)
        return np.asarray(inside & ~other & (seen.feature_class[:, None] == self.table.feature_class[rows]))

    def _covariance(self, view: View, columns: Index, noise: Array) -> Array:
        """Return the covariances (2, 2, C, M) of the innovations of one detection with variances (2,)."""
        by_feature = self.model.feature_jacobian(self.particles.pose, view.points[:, columns])
        every = np.broadcast_to(noise[:, None], (2, len(columns)))
        return self._innovation_covariance(view.rows[columns], view.sight.distance[columns], by_feature, every)

    def _choose(
        self,
        view: View,
        seen: Seen,
        detections: Index,
        columns: Index,
        *,
        fits: NDArray[np.bool_],
        by_noise: Array | None,
    ) -> tuple[Array, Array, Index]:
        """Return innovations (2, D, M), covariances (2, 2, D, M) and index of the column (D, M) that fits best."""
        count = len(self.particles)
        predicted = self._calibrated(self.model.sight(self.particles.pose, view.points[:, columns]))
        innovation = np.empty((2, len(detections), count))
        covariance = np.empty((2, 2, len(detections), count))
        chosen = np.empty((len(detections), count), dtype=np.intp)
        every = np.arange(count)
        for index, detection in enumerate(detections.tolist()):
            nu = self.model.innovation(seen.measurement[:, detection, None, None], predicted)
            q = self._covariance(view, columns, seen.noise[:, detection])
            whole = q if by_noise is None else q + ekf.product(by_noise, ekf.transpose(by_noise))
            likelihood = weighting.gaussian_log_likelihood(nu, whole)
            best = np.where(fits[index][:, None], likelihood, -np.inf).argmax(axis=0)
            innovation[:, index], covariance[:, :, index], chosen[index] = (
                nu[:, best, every],
                q[:, :, best, every],
                best,
            )
        return innovation, covariance, chosen
