"""The result of a drive: what one car says about each feature of the map, and what it found."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from slamcu_core.filter import FeatureEstimate
from slamcu_core.formats import ChangeState, ResultFeature


def result_features(estimates: Iterable[FeatureEstimate]) -> Iterator[ResultFeature]:
    """Turn what a session believes into the features of a result file (`slamcu_core.formats.write_results`).

    Every feature of the map appears. A watch feature is not in the map: it appears as new where the car found it to be
    there, and not at all otherwise.

    ::

        Path("result.geojson").write_text("".join(write_results(result_features(session.features()))))
    """
    for one in estimates:
        state = ChangeState(one.state)
        mapped = one.feature is not None and not one.feature.watched
        if one.feature is not None and one.feature.watched:
            if one.passes == 0 or state not in {ChangeState.NORMAL, ChangeState.NEW}:
                continue
            state = ChangeState.NEW
        was = one.feature if state in {ChangeState.MOVED, ChangeState.MODIFIED} else None
        xx, xy, yy = one.covariance_m2
        yield ResultFeature(
            state=state,
            lon=one.lon,
            lat=one.lat,
            mass_exists=one.masses.exists,
            mass_not_exists=one.masses.not_exists,
            mass_unknown=one.masses.unknown,
            conflict=one.conflict,
            # a map may claim to be exact; a covariance of zero is none
            covariance_m2=one.covariance_m2 if xx > 0.0 and xx * yy > xy * xy else None,
            passes=one.passes,
            vehicles=1 if one.passes else 0,
            map_object_id=one.feature.object_id if mapped and one.feature is not None else None,
            feature_class=one.feature_class,
            sign=one.sign,
            value=one.value,
            from_lonlat=(was.lon, was.lat) if was and state is ChangeState.MOVED else None,
            map_sign=was.sign if was and state is ChangeState.MODIFIED else None,
            map_value=was.value if was and state is ChangeState.MODIFIED else None,
        )
