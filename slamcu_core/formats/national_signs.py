"""National numbers of traffic signs as SENSORIS sign types and values: data, to which countries are added.

A number that is not here is no error: the sign stands in the map without a type, and is matched by class alone.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_CODE = re.compile(r"(?P<country>[a-z]{2}):?(?P<number>\d+(?:\.\d+)?)(?:-(?P<variant>\d+))?")

# Germany: annexes 1 to 3 of the Straßenverkehrs-Ordnung, variants by its catalogue of 2017. Numbers without a decimal
# beside one with it (242, 290, 325, 330 ...) are those of before 2013.
_GERMANY = """
    101 GENERAL_WARNING                       102 CROSSING_WITH_PRIORITY_TO_THE_RIGHT
    103 SHARP_CURVE                           103-10 SHARP_CURVE_LEFT        103-20 SHARP_CURVE_RIGHT
    105 WINDING_ROAD                          105-10 WINDING_ROAD_STARTING_LEFT
    105-20 WINDING_ROAD_STARTING_RIGHT        108 STEEP_HILL_DOWNWARDS       110 STEEP_HILL_UPWARDS
    112 UNEVEN_ROAD                           114 SLIPPERY_ROAD              117 LATERAL_WIND
    120 ROAD_NARROWS                          121 ROAD_NARROWS               121-10 ROAD_NARROWS_RIGHT
    121-20 ROAD_NARROWS_LEFT                  123 CONSTRUCTION               124 CONGESTION_HAZARD
    125 TWO_WAY_TRAFFIC                       131 SIGNAL_AHEAD               133 WARNING_PEDESTRIAN
    136 WARNING_CHILDREN                      138 WARNING_BICYCLE            142 ANIMAL_DEER
    151 RAILWAY_CROSSING_GENERAL              205 YIELD                      206 STOP_SIGN
    208 YIELD_TO_ONCOMING_TRAFFIC             209 MANDATORY_TURN_RIGHT_ONLY  209-10 MANDATORY_TURN_LEFT_ONLY
    209-20 MANDATORY_TURN_RIGHT_ONLY          209-30 MANDATORY_STRAIGHT_ONLY 214 MANDATORY_STRAIGHT_OR_RIGHT
    214-10 MANDATORY_STRAIGHT_OR_LEFT         214-20 MANDATORY_STRAIGHT_OR_RIGHT
    214-30 MANDATORY_TURN_LEFT_OR_RIGHT       215 ROUNDABOUT                 220 ONEWAY_TRAFFIC
    220-10 ONEWAY_TRAFFIC_TO_LEFT             220-20 ONEWAY_TRAFFIC_TO_RIGHT 222 PASSING_ON_RIGHT
    222-10 PASSING_ON_LEFT                    222-20 PASSING_ON_RIGHT
    223.1 SHOULDER_OPEN_FOR_TRAFFIC           223.2 SHOULDER_CLOSED_FOR_TRAFFIC
    224 PUBLIC_TRANSPORTATION_STOP            229 NO_STOPPING_EXCEPT_TAXI    237 BICYCLE_PATH
    239 PEDESTRIAN_PATH                       240 PEDESTRIAN_BICYCLE_SHARED_PATH
    241 PEDESTRIAN_BICYCLE_PATH               242 PEDESTRIAN_ZONE            242.1 PEDESTRIAN_ZONE
    242.2 PEDESTRIAN_ZONE_END                 243 PEDESTRIAN_ZONE_END        244 BICYCLE_STREET
    244.1 BICYCLE_STREET                      244.2 BICYCLE_STREET_END       245 BUS_LANE
    250 NO_VEHICLE                            253 NO_TRUCK                   254 NO_BICYCLE
    255 NO_MOTORCYCLE                         259 NO_PEDESTRIAN              260 NO_MOTOR_VEHICLE
    261 NO_HAUL_HAZARDOUS_MATERIAL            262 WEIGHT_RESTRICTION         263 AXLE_WEIGHT_RESTRICTION
    264 WIDTH_RESTRICTION                     265 HEIGHT_RESTRICTION         266 LENGTH_RESTRICTION
    267 NO_ENTRY                              268 TIRE_CHAINS_MANDATORY      269 NO_HAUL_HARMFUL_TO_WATER
    270.1 ENVIRONMENTAL_AREA                  270.2 ENVIRONMENTAL_AREA_END   272 NO_U_TURN
    273 SAFETY_DISTANCE                       274 SPEED_LIMIT                274.1 SPEED_LIMIT_ZONE
    274.2 SPEED_LIMIT_ZONE_END                275 MINIMUM_SPEED              276 NO_OVERTAKING
    277 NO_OVERTAKING_TRUCK                   278 SPEED_LIMIT_END            279 MINIMUM_SPEED_END
    280 NO_OVERTAKING_END                     281 NO_OVERTAKING_TRUCK_END    282 ALL_RESTRICTIONS_END
    283 NO_STOPPING                           286 NO_PARKING                 290 NO_PARKING_ZONE
    290.1 NO_PARKING_ZONE                     290.2 NO_PARKING_ZONE_END      292 NO_PARKING_ZONE_END
    301 CROSSING_WITH_PRIORITY_OVER_MINOR_ROAD                               306 PRIORITY_ROAD
    307 PRIORITY_ROAD_END                     308 PRIORITY_OVER_ONCOMING_TRAFFIC
    310 CITY_START                            311 CITY_END                   314 PARKING
    314.1 PARKING_ZONE                        314.2 PARKING_ZONE_END         315 PARKING_ON_SIDEWAY
    316 PARK_AND_RIDE                         325 TRAFFIC_CALMING            325.1 TRAFFIC_CALMING
    325.2 TRAFFIC_CALMING_END                 326 TRAFFIC_CALMING_END        327 TUNNEL
    328 BREAKDOWN_BAY                         330 MOTORWAY                   330.1 MOTORWAY
    330.2 MOTORWAY_END                        331 HIGHWAY                    331.1 HIGHWAY
    331.2 HIGHWAY_END                         333 MOTORWAY_EXIT              334 MOTORWAY_END
    336 HIGHWAY_END                           350 PEDESTRIAN_CROSSING        354 WATER_PROTECTION_AREA
    357 DEAD_END                              448 MOTORWAY_EXIT_AHEAD        454 DETOUR
"""

_SIGNS: dict[str, dict[str, str]] = {
    country: dict(zip(words[::2], words[1::2], strict=True)) for country, words in {"de": _GERMANY.split()}.items()
}
_SPEED_BY_VARIANT = {("de", number) for number in ("274", "274.1", "274.2", "275", "278", "279")}  # in km/h
_SPEED = {("de", "274.1"): "30", ("de", "274.2"): "30"}  # shown by the sign without a variant


class NationalSign(NamedTuple):
    """What a national number says, as far as it is known here."""

    sign: str | None  # SENSORIS TrafficSign type name
    value: str | None


def read_national_sign(code: str) -> NationalSign:
    """Return type and value of a sign by its country and number, such as ``de205``, ``de274-50`` or ``de274_1``.

    Both are None for a number, or a country, that is not known.
    """
    match = _CODE.fullmatch(code.strip().lower().replace("_", "."))
    if match is None:
        return NationalSign(None, None)
    country, number, variant = match["country"], match["number"], match["variant"]
    known = _SIGNS.get(country, {})
    sign = known.get(f"{number}-{variant}", known.get(number))
    value = variant if (country, number) in _SPEED_BY_VARIANT and variant else _SPEED.get((country, number))
    return NationalSign(sign, value)
