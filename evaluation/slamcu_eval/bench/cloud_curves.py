"""What one evidence costs as the map grows, and as what is stored grows: one worker, the same traffic."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from slamcu_eval.bench.aggregation import AggregationBench, Load
from slamcu_eval.bench.cloud import Cloud
from slamcu_eval.bench.rounds import interleave
from slamcu_server.database.embedded import EmbeddedCluster


def cloud_map_curve(cluster: EmbeddedCluster, sizes: Sequence[int], load: Load) -> dict[str, Any]:
    """Return the cost of an evidence, in µs, for maps of some sizes about which nothing has been reported before."""
    return _curve(cluster, "map", [(size, size, 0) for size in sizes], load)


def cloud_stored_curve(cluster: EmbeddedCluster, features: int, stored: Sequence[int], load: Load) -> dict[str, Any]:
    """Return the cost of an evidence, in µs, on one map about which more and more has been reported before."""
    steps = [(count, features, count // features) for count in stored]
    return {"map_features": features, **_curve(cluster, "stored", steps, load)}


def _curve(cluster: EmbeddedCluster, name: str, steps: Sequence[tuple[int, int, int]], load: Load) -> dict[str, Any]:
    benches = {
        str(label): AggregationBench(
            asyncio.run(
                Cloud.make(cluster, f"bench_{name}_{label}", features, seed=load.seed, stored_per_feature=stored)
            ),
            load,
        )
        for label, features, stored in steps
    }
    rates = interleave({label: bench.fused_by(1) for label, bench in benches.items()}, load.rounds)
    used = {label: sum(bench.processor_time().values()) for label, bench in benches.items()}
    smallest, largest = str(steps[0][0]), str(steps[-1][0])
    return {
        "microseconds": {label: 1e6 / rate.median for label, rate in rates.items()},
        "processor_us": used,
        "largest_over_smallest": used[largest] / used[smallest] if used[smallest] else None,
        "rounds": load.rounds,
        "messages_per_round": load.messages,
    }
