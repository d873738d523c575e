"""Where things are and what they are, as the filter would tell somebody: places, and estimates of every feature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.evidence import Masses, conflict, support
from slamcu_core.filter.calibration import SensorCalibration
from slamcu_core.filter.ekf import inverse_2x2
from slamcu_core.filter.estimates import FeatureEstimate
from slamcu_core.filter.existence import State
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.hd_map import HDMap, MapFeature
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
        calibration: SensorCalibration,
        management: MapManagement,
        names: Vocabulary,
        parameters: FilterParameters,
    ) -> None:
        self._map, self._table, self._particles, self._around = hd_map, table, particles, around
        self._calibration, self._management = calibration, management
        self._names, self._parameters = names, parameters

    def place(self, row: int) -> tuple[Array, Array]:
        """Return where a row is by the car's own measurements: mean (2,) and covariance (2, 2), pose included.

        What no detection could average out (the calibration's rest, and what is constant within a pass) is added
        along and across the line of sight.
        """
        table = self._table
        if table.kind[row] != Kind.NEW:
            inverse, _ = inverse_2x2(table.seen_information[row])
            xy, covariance = inverse @ table.seen_vector[row], inverse + self._particles.place_covariance()
        elif table.slot[row] >= 0:
            xy, covariance = self._particles.collapse(int(table.slot[row]))
        else:
            xy, covariance = table.xy[row].copy(), table.covariance[row].copy()
        if table.view_weight[row] > 0.0:
            line = xy - table.view_from[row] / table.view_weight[row]
            across = np.array([-line[1], line[0]])
            range_variance = self._calibration.variance[0] + self._parameters.pass_range_std**2
            covariance = covariance + range_variance * np.outer(line, line)
            covariance += self._calibration.variance[1] * np.outer(across, across)
        return xy, covariance

    def position(self, row: int) -> MeasuredPosition:
        """Return the place of a row in geographic coordinates."""
        xy, covariance = self.place(row)
        lon, lat = self._around.frame.to_geographic(xy)
        spread = float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])
        return MeasuredPosition(float(lon), float(lat), spread)

    def estimates(self) -> list[FeatureEstimate]:
        """Return what is believed of every feature of the map, also those never near, and of the car's own finds."""
        mapped = [self._mapped(feature, self._around.row_of(index)) for index, feature in enumerate(self._map)]
        own = ((self._table.kind == Kind.NEW) & self._table.alive).nonzero()[0]
        return mapped + [self._found(row) for row in own.tolist()]

    def _mapped(self, feature: MapFeature, row: int | None) -> FeatureEstimate:
        if row is None:
            f = 0.0 if feature.watched else float(support(feature.existence_confidence))
            state, a, passes = (State.NORMAL if f > np.log(2.0) else State.UNCLASSIFIED).value, 0.0, 0
        else:
            state, f, a, passes = self._belief(row)
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

    def _found(self, row: int) -> FeatureEstimate:
        state, f, a, passes = self._belief(row)
        place, table, name = self.position(row), self._table, self._names.name
        return FeatureEstimate(
            feature=None,
            state=state,
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

    def _belief(self, row: int) -> tuple[str, float, float, int]:
        """Return class, weights for (with the prior) and against, and number of passes of a row."""
        table = self._table
        state = str(self._management.classify(np.array([row], dtype=np.intp))[0])
        f, a = table.prior[row] + table.weight_for[row], table.weight_against[row]
        return state, float(f), float(a), int(table.passes[row])
