"""A simulated motorway as files: map, truth, drive logs, and the reference poses apart from the logs.

    DIR/map.geojson              what vehicles get
    DIR/truth.geojson            what is so; for scoring only
    DIR/drives/veh-000.jsonl.gz  what each vehicle records
    DIR/reference/veh-000.csv    where it really was; for scoring only

Each file appears whole or not at all.
"""

from __future__ import annotations

import csv
import gzip
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from slamcu_core.errors import SlamcuError
from slamcu_core.formats.drive_log import write_drive_log
from slamcu_core.formats.hd_map import write_hd_map
from slamcu_core.formats.results import ChangeState, TruthFeature, write_truth
from slamcu_eval.highway.drive import Drive
from slamcu_eval.highway.world import Place, World

_REFERENCE_EVERY = 5  # of 50 poses a second: 10 Hz is within 4 mm when interpolated


def truth_features(world: World) -> Iterator[TruthFeature]:
    """Iterate over what is true of a world, in the terms of a truth file."""
    for number, sign in enumerate(world.signs, start=1):
        moved, modified = sign.truth is ChangeState.MOVED, sign.truth is ChangeState.MODIFIED
        deleted = sign.place is None
        lon, lat = _lonlat(world, sign.place or sign.map_place)
        yield TruthFeature(
            truth=sign.truth,
            lon=lon,
            lat=lat,
            sign=sign.map_sign if deleted else sign.sign,
            value=sign.map_value if deleted else sign.value,
            map_object_id=sign.map_object_id,
            from_lonlat=_lonlat(world, sign.map_place) if moved else None,
            map_sign=sign.map_sign if modified else None,
            map_value=sign.map_value if modified else None,
            id=number,
        )


def prepare_folder(folder: Path) -> None:
    """Make the folders of a simulation. Raises SlamcuError if drives of another one lie there."""
    for name in ("drives", "reference"):
        (folder / name).mkdir(parents=True, exist_ok=True)
        if any((folder / name).iterdir()):
            raise SlamcuError(f"{folder / name} is not empty: remove it or choose another --out")


def write_world(world: World, folder: Path) -> None:
    """Write map and truth of a world."""
    _write(folder / "map.geojson", write_hd_map(world.hd_map.identity, world.hd_map))
    _write(folder / "truth.geojson", write_truth(truth_features(world)))


def write_drive(drive: Drive, folder: Path) -> None:
    """Write the log of a drive, and its reference poses beside."""
    name = drive.header.vehicle_id
    _write(folder / "drives" / f"{name}.jsonl.gz", write_drive_log(drive.header, drive.records))
    r = drive.reference
    path = folder / "reference" / f"{name}.csv"
    with path.with_suffix(".part").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("t", "lon", "lat", "heading_deg"))
        columns = [
            np.round(column[::_REFERENCE_EVERY], n).tolist()
            for column, n in ((r.t, 4), (r.lon, 9), (r.lat, 9), (r.heading_deg, 4))
        ]
        table.writerows(zip(*columns, strict=True))
    path.with_suffix(".part").replace(path)


def _lonlat(world: World, place: Place | None) -> tuple[float, float]:
    lon, lat = world.frame.to_geographic(np.array(place))
    return round(float(lon), 9), round(float(lat), 9)


def _write(path: Path, pieces: Iterable[str]) -> None:
    part = path.with_name(path.name + ".part")
    if path.suffix == ".gz":
        # mtime 0: equal seeds give equal bytes
        with part.open("wb") as raw, gzip.GzipFile("", "wb", compresslevel=6, fileobj=raw, mtime=0) as packed:
            packed.writelines(piece.encode() for piece in pieces)
    else:
        with part.open("w", encoding="utf-8") as file:
            file.writelines(pieces)
    part.replace(path)
