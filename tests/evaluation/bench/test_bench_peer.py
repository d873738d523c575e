"""The bench's peer, in loops, and the filter's arrays are the same equations 16-19."""

from __future__ import annotations

import numpy as np
import pytest

from slamcu_core.models import SensorModel
from slamcu_eval.bench.kernel import step_input
from slamcu_eval.bench.peer import numpy_step, peer_step
from slamcu_eval.bench.scene import CAMERA


@pytest.mark.parametrize("seed", range(5))
def test_loops_and_arrays_give_the_same_weights_means_and_covariances(seed: int) -> None:
    step = step_input(particles=30, known=8, new=4, rng=np.random.default_rng(seed))
    ours, peer = numpy_step(SensorModel(CAMERA), step), peer_step(step)
    np.testing.assert_allclose(ours.log_weight, peer.log_weight, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(ours.means, peer.means, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(ours.covariances, peer.covariances, rtol=1e-9, atol=1e-9)
    assert np.ptp(ours.log_weight) > 1.0, "the particles are told apart"
