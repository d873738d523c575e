"""Association per particle (FastSLAM), to be compared with the filter's, which all particles share.

Existence, passes and the maps of new features go by the shared association as before, for the paper's map management
is one for all particles (section 4.3); the weights and the proposal go by each particle's own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import ekf, proposal, weighting
from slamcu_core.filter.detections import Seen
from slamcu_core.filter.frame_update import CloseLook, FrameUpdate, Matches
from slamcu_core.filter.view import View
from slamcu_core.geometry import mahalanobis_square
from slamcu_eval.ablation.parts import weighs_as_normal

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class PerParticle(FrameUpdate):
    """A frame update in which each particle takes every detection for the feature that fits it best from there."""

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
        """Weigh the particles, each by its own association with Normal and New features (eq. 17-19)."""
        particles = self.particles
        columns = np.flatnonzero(weighs_as_normal(self.table, view.rows[: view.close]))
        columns = np.union1d(columns, matched[1][usable]).astype(np.intp)
        fits = self._fits(view, seen, columns)
        detections = np.flatnonzero(fits.any(axis=1))
        if not len(detections):
            particles.settle(rng)
            return self.match(view, seen, matched)
        fits = fits[detections]
        close = self.examine(view, columns)
        open_noise = None
        if particles.pending is not None:
            by_noise = proposal.noise_jacobian(self.model.by_pose(close.sight, close.by_feature), particles.pending)
            first = self._covariance(close, seen.noise[:, detections[0]])
            if proposal.pays((by_noise**2).sum(axis=1).mean(axis=-1), first[::2].mean(axis=-1)):
                open_noise = by_noise
            else:
                particles.settle(rng)
                close = self.examine(view, columns)
        innovation, covariance, chosen = self._choose(close, seen, detections, fits=fits, by_noise=open_noise)
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
        return self.match(view, seen, matched)

    def _fits(self, view: View, seen: Seen, columns: Index) -> NDArray[np.bool_]:
        """Return which detection could be which column (D, C): by class and by the gate with the particles averaged."""
        rows, marginal = view.rows[columns], view.marginal
        nu = self.model.innovation(seen.measurement[:, :, None], marginal.mean[:, None, columns])
        xx, xy, yy = marginal.covariance[:, columns]
        covariance = xx + seen.noise[0, :, None], xy, yy + seen.noise[1, :, None]
        inside = mahalanobis_square(nu, covariance)[0] < self.parameters.gate
        signs, values = self.table.sign[rows], self.table.value[rows]
        other = (seen.sign[:, None] != signs) & (seen.sign[:, None] > 0) & (signs > 0)
        other |= (seen.value[:, None] != values) & (seen.value[:, None] > 0) & (values > 0)
        return np.asarray(inside & ~other & (seen.feature_class[:, None] == self.table.feature_class[rows]))

    def _covariance(self, close: CloseLook, noise: Array) -> Array:
        """Return the covariances (3, C, M) of the innovations of one detection with variances (2,)."""
        return self.innovation_covariance(close, np.broadcast_to(noise[:, None], (2, len(close.rows))))

    def _choose(
        self,
        close: CloseLook,
        seen: Seen,
        detections: Index,
        *,
        fits: NDArray[np.bool_],
        by_noise: Array | None,
    ) -> tuple[Array, Array, Index]:
        """Return innovations (2, D, M), covariances (3, D, M) and index of the column (D, M) that fits best."""
        count = len(self.particles)
        predicted = self.calibrated(close.sight)
        innovation = np.empty((2, len(detections), count))
        covariance = np.empty((3, len(detections), count))
        chosen = np.empty((len(detections), count), dtype=np.intp)
        every = np.arange(count)
        for index, detection in enumerate(detections.tolist()):
            nu = self.model.innovation(seen.measurement[:, detection, None, None], predicted)
            q = self._covariance(close, seen.noise[:, detection])
            whole = q
            if by_noise is not None:
                (xx, xy), (_, yy) = ekf.product(by_noise, ekf.transpose(by_noise))
                whole = q + np.array([xx, xy, yy])
            likelihood = weighting.gaussian_log_likelihood(nu, whole)
            best = np.where(fits[index][:, None], likelihood, -np.inf).argmax(axis=0)
            innovation[:, index], covariance[:, index] = nu[:, best, every], q[:, best, every]
            chosen[index] = best
        return innovation, covariance, chosen
