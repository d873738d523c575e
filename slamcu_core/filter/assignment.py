"""One-to-one assignment of detections to features with the largest total score (errata to section 4.3.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def assign(score: Array) -> NDArray[np.intp]:
    """Return for each of D detections the index of its feature among F, or -1.

    Parameters
    ----------
    score : (D, F) log likelihood ratios of "this feature" against "something else"; -inf where gated out. Only
        positive scores are worth assigning.

    The total score of the assigned pairs is the largest possible.
    """
    detections, features = score.shape
    result = np.empty(detections, dtype=np.intp)
    result.fill(-1)
    if not detections or not features:
        return result
    best = score.argmax(axis=1)
    rows = (score[np.arange(detections), best] > 0.0).nonzero()[0]
    chosen = best[rows]
    if len(set(chosen.tolist())) == len(rows):
        result[rows] = chosen
        return result
    columns = ((score[rows] > 0.0).any(axis=0)).nonzero()[0]
    gain = np.maximum(score[np.ix_(rows, columns)], 0.0)
    if len(rows) <= len(columns):
        pairs = list(enumerate(_shortest_augmenting_paths(_or_alone(gain))))
    else:  # the fewer choose: their number counts twice in what it costs
        pairs = [(row, column) for column, row in enumerate(_shortest_augmenting_paths(_or_alone(gain.T)))]
    for row, column in pairs:
        if row < len(rows) and column < len(columns) and gain[row, column] > 0.0:
            result[rows[row]] = columns[column]
    return result


def _or_alone(gain: Array) -> Array:
    """Return costs (A, B + A) for gains (A, B): each has a column of its own at no cost, to stay alone in."""
    return np.concatenate([-gain, np.zeros((len(gain), len(gain)))], axis=1)


def _shortest_augmenting_paths(cost: Array) -> list[int]:
    """Return the column of each row in the assignment of least total cost; rows must not outnumber columns."""
    rows, columns = cost.shape
    price_row, price_column = np.zeros(rows), np.zeros(columns)
    row_of = np.full(columns, -1, dtype=np.intp)
    for start in range(rows):
        distance = np.full(columns, np.inf)
        previous = np.full(columns, -1, dtype=np.intp)
        done = np.zeros(columns, dtype=bool)
        reached_rows, reached_cost = [start], [0.0]
        row, so_far, last = start, 0.0, -1
        while True:
            reduced = so_far + cost[row] - price_row[row] - price_column
            better = ~done & (reduced < distance)
            distance[better] = reduced[better]
            previous[better] = last
            column = int(np.argmin(np.where(done, np.inf, distance)))
            so_far = float(distance[column])
            done[column] = True
            if row_of[column] < 0:
                break
            row, last = int(row_of[column]), column
            reached_rows.append(row)
            reached_cost.append(so_far)
        for reached, at in zip(reached_rows, reached_cost, strict=True):
            price_row[reached] += so_far - at
        price_column[done] += distance[done] - so_far
        while True:  # flip the path back to the start
            last = int(previous[column])
            row_of[column] = start if last < 0 else row_of[last]
            if last < 0:
                break
            column = last
    result = [-1] * rows
    for column, row in enumerate(row_of.tolist()):
        if row >= 0:
            result[row] = column
    return result
