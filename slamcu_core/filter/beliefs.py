"""Where things are and what they are, as the filter would tell somebody: places, and estimates of every feature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.evidence import LN_2, Masses, conflict, support
from slamcu_core.filter.calibration import Calibrations
from slamcu_core.filter.estimates import FeatureEstimate, PoseEstimate
from slamcu_core.filter.existence import State
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.prediction import Travel
from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.geometry import math_to_compass
from slamcu_core.hd_map import HDMap, MapFeature
from slamcu_core.models import advance
from slamcu_core.reports import MeasuredPosition

Array = NDArray[np.float64]


class Beliefs:
    """Reads places and estimates out of the table and the particles; changes neither."""

    def __init__(
        self,
        hd_map: HDMap,
        *,
        table: FeatureTable,
        particles: Particles,
        around: Neighbourhood,
        calibrations: Calibrations,
        management: MapManagement,
        names: Vocabulary,
        parameters: FilterParameters,
    ) -> None:
        self._map, self._table, self._particles, self._around = hd_map, table, particles, around
        self._calibrations, self._management = calibrations, management
        self._names, self._parameters = names, parameters

    def pose(self, t: float, ahead: Travel) -> PoseEstimate:
        """Return the pose at t s, by the way `ahead` of the particles that they have not made yet."""
        mean, covariance = self._particles.mean_state()
        # added here, not to the particles: to ask is not to act
        mean[:3] = advance(mean[:3], ahead.distance * float(mean[3]), ahead.turn * float(mean[4]))
        lon, lat = self._around.frame.to_geographic(mean[:2])
        return PoseEstimate(
            t,
            float(lon),
            float(lat),
            math_to_compass(float(mean[2])),
            (float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])),
            float(np.rad2deg(np.sqrt(covariance[2, 2]))),
        )

    def place(self, row: int) -> tuple[Array, Array]:
        """Return where a row is by the car's own measurements: mean (2,) and covariance (3,), pose included.

        What no detection could average out (the calibration's rest, and what is constant within a pass) is added
        along and across the line of sight.
        """
        table = self._table
        if table.slot[row] >= 0:
            means, covariances = self._particles.collapse(table.slot[[row]])
            xy, covariance = means[:, 0], covariances[:, 0]
        elif table.kind[row] != Kind.NEW:
            xy, covariance = self._by_sightings(row)
        else:
            xy, covariance = table.xy[row].copy(), table.covariance[row].copy()
        if table.view_weight[row] > 0.0:
            covariance = self._with_bias(covariance, xy - table.view_from[row] / table.view_weight[row])
        return xy, covariance

    def _by_sightings(self, row: int) -> tuple[Array, Array]:
        """Return where a row of the map is by the sums over its sightings: mean (2,) and covariance (3,).

        What the first sensor's errors, as far as they are known now, have added to the sums is taken from them: what
        the particles place is estimated with the calibration, what the map has is only noted as it was shown.
        """
        xx, cross, _, yy, x, y, *_, scale_x, scale_y, turn_x, turn_y = self._table.sighted[row].tolist()
        scale, turn = (self._particles.calibration[:2] @ self._particles.weights).tolist()
        stretch = scale / (1.0 + scale)
        x -= stretch * scale_x + turn * turn_x
        y -= stretch * scale_y + turn * turn_y
        determinant = xx * yy - cross * cross
        xx, cross, yy = yy / determinant, -cross / determinant, xx / determinant
        covariance = np.array([xx, cross, yy])
        covariance += self._particles.place_covariance()
        return np.array([xx * x + cross * y, cross * x + yy * y]), covariance

    def _with_bias(self, covariance: Array, line: Array) -> Array:
        """Add to a covariance (3,) what the car's detections along a line of sight (2,) have wrong in common."""
        x, y = line.tolist()
        along, across = self._calibrations.vaguest
        along += self._parameters.pass_range_std**2
        common = along * x * x + across * y * y, (along - across) * x * y, along * y * y + across * x * x
        return np.asarray(covariance + common)

    def position(self, place: tuple[Array, Array]) -> MeasuredPosition:
        """Return a place, mean (2,) and covariance (3,), in geographic coordinates."""
        xy, covariance = place
        lon, lat = self._around.frame.to_geographic(xy)
        return MeasuredPosition(float(lon), float(lat), _spread(covariance))

    def _position_behind(self, row: int) -> MeasuredPosition:
        """Return the place of a find that was left behind, a row of the archive."""
        found, frame = self._around.found, self._around.frame
        lon, lat = found.table.xy[row]
        covariance = found.table.covariance[row]
        if found.table.view_weight[row] > 0.0:
            covariance = self._with_bias(covariance, found.place(row, frame) - found.seen_from(row, frame))
        return MeasuredPosition(float(lon), float(lat), _spread(covariance))

    def estimates(self) -> list[FeatureEstimate]:
        """Return what is believed of every feature of the map, also those never near, and of the car's own finds."""
        table, behind = self._table, self._around.found
        mapped = [self._mapped(feature, index) for index, feature in enumerate(self._map)]
        left = [self._found(behind.table, row, self._position_behind(row)) for row in behind.rows()]
        own = ((table.kind == Kind.NEW) & table.alive).nonzero()[0].tolist()
        return mapped + left + [self._found(table, row, self.position(self.place(row))) for row in own]

    def _mapped(self, feature: MapFeature, index: int) -> FeatureEstimate:
        row, ledger = self._around.row_of(index), self._around.ledger
        if row is None:
            prior = float(support(self._map.prior(feature)))
            f, a = prior + float(ledger.weight_for[index]), float(ledger.weight_against[index])
            state, passes = _map_state(f, a, watched=feature.watched), int(ledger.passes[index])
        else:
            f, a, passes = _belief(self._table, row)
            state = self._state(row)
        variance = feature.position_std_m**2
        return FeatureEstimate(
            feature=feature,
            state=state,
            masses=Masses.from_weights(f, a),
            conflict=float(conflict(f, a)),
            lon=feature.lon,
            lat=feature.lat,
            covariance_m2=(variance, 0.0, variance),
            passes=passes,
            feature_class=feature.feature_class,
            sign=feature.sign,
            value=feature.value,
        )

    def _found(self, table: FeatureTable, row: int, place: MeasuredPosition) -> FeatureEstimate:
        f, a, passes = _belief(table, row)
        # what was left behind has proven itself, or it would have been forgotten
        behind = (State.NEW if f > max(a, LN_2) else State.UNCLASSIFIED).value
        name = self._names.name
        return FeatureEstimate(
            feature=None,
            state=self._state(row) if table is self._table else behind,
            masses=Masses.from_weights(f, a),
            conflict=float(conflict(f, a)),
            lon=place.lon,
            lat=place.lat,
            covariance_m2=place.covariance_m2,
            passes=passes,
            feature_class=name(int(table.feature_class[row])) or "",
            sign=name(int(table.sign[row])),
            value=name(int(table.value[row])),
        )

    def _state(self, row: int) -> str:
        return str(self._management.classify(np.array([row], dtype=np.intp))[0])


def _belief(table: FeatureTable, row: int) -> tuple[float, float, int]:
    """Return weights for (with the prior) and against, and number of passes of a row."""
    f, a = table.prior[row] + table.weight_for[row], table.weight_against[row]
    return float(f), float(a), int(table.passes[row])


def _map_state(weight_for: float, weight_against: float, *, watched: bool) -> str:
    """Return the class of a feature of the map by its largest mass (section 4.3.3), from its weights."""
    if weight_for > max(weight_against, LN_2):
        return (State.NEW if watched else State.NORMAL).value
    if weight_against > max(weight_for, LN_2) and not watched:
        return State.DELETED.value
    return State.UNCLASSIFIED.value


def _spread(covariance: Array) -> tuple[float, float, float]:
    xx, xy, yy = covariance.tolist()
    return xx, xy, yy
