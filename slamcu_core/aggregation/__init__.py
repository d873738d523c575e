"""The cloud's half of the evidence law as pure functions: folding contributions, positions, candidates."""

from slamcu_core.aggregation.candidates import Clusters, cluster
from slamcu_core.aggregation.groups import connected_groups
from slamcu_core.aggregation.law import (
    EPOCH_S,
    Contribution,
    FoldedState,
    FoldStep,
    PassEvidence,
    Side,
    contributions,
    decayed,
    fold,
)
from slamcu_core.aggregation.policy import ClassPolicy, Policy
from slamcu_core.aggregation.position import FusedPosition, fuse_positions

__all__ = [
    "EPOCH_S",
    "ClassPolicy",
    "Clusters",
    "Contribution",
    "FoldStep",
    "FoldedState",
    "FusedPosition",
    "PassEvidence",
    "Policy",
    "Side",
    "cluster",
    "connected_groups",
    "contributions",
    "decayed",
    "fold",
    "fuse_positions",
]
