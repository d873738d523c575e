"""The server's answer to a batch of messages, believed only if it accounts for each of them."""

from __future__ import annotations

from dataclasses import dataclass

from slamcu_client.received import one_line, parse_json
from slamcu_client.server import is_own_problem
from slamcu_client.transport import Response


@dataclass(frozen=True, slots=True)
class Receipt:
    """What became of the messages of one batch; those that are not rejected are in the server's log."""

    accepted: int
    duplicates: int
    rejected: tuple[tuple[int, str, str], ...]  # index in the batch, reason, detail


def read_receipt(response: Response, count: int) -> Receipt | None:
    """Read the receipt for a batch of `count` messages; None if the answer is no receipt for that batch.

    A hotspot or proxy may answer 200 with a page of its own: taking that for a receipt would lose the batch.
    """
    refused_all = response.status == 422 and is_own_problem(response)  # a problem document with the same members
    if response.status not in {200, 202} and not refused_all:
        return None
    try:
        document = parse_json(response.content)
        accepted, duplicates = document["accepted"], document["duplicates"]
        rejected = tuple(
            (item["index"], one_line(str(item["reason"])), one_line(str(item.get("detail") or "")))
            for item in document["rejected"]
        )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    indices = [index for index, _, _ in rejected]
    numbers = [accepted, duplicates, *indices]
    if not all(isinstance(number, int) and not isinstance(number, bool) and number >= 0 for number in numbers):
        return None
    if accepted + duplicates + len(rejected) != count:
        return None
    if len(set(indices)) != len(indices) or any(index >= count for index in indices):
        return None
    return Receipt(accepted, duplicates, rejected)
