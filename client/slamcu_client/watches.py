"""Watch features that cannot be used are passed over: what others have found must not cost a car its map."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from slamcu_client.map_pages import MapPage
from slamcu_client.received import one_line
from slamcu_core.errors import FormatError
from slamcu_core.formats import load_hd_map

_log = logging.getLogger(__name__)


def without_unusable_watches(pages: Iterable[MapPage]) -> tuple[MapPage, ...]:
    """Return the pages of a map without the watch features that no map can hold, each of which is logged."""
    kept: list[MapPage] = []
    seen: set[int] = set()
    for page in pages:
        features = tuple(feature for feature in page.features if not _is_watch(feature) or _is_usable(feature, seen))
        # an unchanged page stays the same object, and equal to what the cache has of it
        kept.append(page if len(features) == len(page.features) else replace(page, features=features))
    return tuple(kept)


def _is_watch(feature: Any) -> bool:
    properties = feature.get("properties") if isinstance(feature, dict) else None
    if not isinstance(properties, dict):
        return False
    tile_id = properties.get("tile_id")
    return properties.get("watch") is True or (isinstance(tile_id, int) and tile_id < 0)


def _is_usable(feature: dict[str, Any], seen: set[int]) -> bool:
    """Tell whether a feature can be read as one to watch, with an id that none in `seen` has, and add it to them."""
    try:
        text = json.dumps({"type": "FeatureCollection", "features": [feature]}, ensure_ascii=False)
        (one,) = load_hd_map([text.encode()])
    except (ValueError, RecursionError) as error:  # what is wrong with it, half a surrogate pair, brackets without end
        why = error.message if isinstance(error, FormatError) else str(error)
    else:
        if one.watched and one.object_id not in seen:
            seen.add(one.object_id)
            return True
        why = "an earlier one has the same id" if one.watched else "it would be taken for a feature of the map"
    _log.warning("a watch feature of the server cannot be used and is passed over: %s", one_line(why))
    return False
