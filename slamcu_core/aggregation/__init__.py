"""The cloud's half of the evidence law as pure functions: folding contributions, positions, candidates."""

from slamcu_core.aggregation.candidates import Clusters, Passes, cluster
from slamcu_core.aggregation.columns import FoldedColumns, fold_columns
from slamcu_core.aggregation.contribution_columns import PassColumns
from slamcu_core.aggregation.contributions import (
    EPOCH_S,
    Contribution,
    PassEvidence,
    contributions,
)
from slamcu_core.aggregation.course import Course, Histories, discounted, fold_histories, moments
from slamcu_core.aggregation.decay import decayed, fades_at, fades_each, kept_at
from slamcu_core.aggregation.groups import connected_groups
from slamcu_core.aggregation.law import FoldedState, FoldStep, Side, fold
from slamcu_core.aggregation.pairing import Half, Pairing, pair
from slamcu_core.aggregation.policy import ClassPolicy, Policy
from slamcu_core.aggregation.position import FusedPosition, FusedPositions, fuse_positions, fuse_positions_each
from slamcu_core.aggregation.record import (
    About,
    Tally,
    Testimony,
    Verdict,
    has_record,
    is_gated,
    judge,
    tally,
    trust_share,
)
from slamcu_core.aggregation.trust import Trusts

__all__ = [
    "EPOCH_S",
    "About",
    "ClassPolicy",
    "Clusters",
    "Contribution",
    "Course",
    "FoldStep",
    "FoldedColumns",
    "FoldedState",
    "FusedPosition",
    "FusedPositions",
    "Half",
    "Histories",
    "Pairing",
    "PassColumns",
    "PassEvidence",
    "Passes",
    "Policy",
    "Side",
    "Tally",
    "Testimony",
    "Trusts",
    "Verdict",
    "cluster",
    "connected_groups",
    "contributions",
    "decayed",
    "discounted",
    "fades_at",
    "fades_each",
    "fold",
    "fold_columns",
    "fold_histories",
    "fuse_positions",
    "fuse_positions_each",
    "has_record",
    "is_gated",
    "judge",
    "kept_at",
    "moments",
    "pair",
    "tally",
    "trust_share",
]
