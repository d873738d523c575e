"""The whole product in one story: a fleet, faults, a provider, a second fleet, an upgrade and a restore.

The story is told once (`story`); a `System` is what it is told about: plain processes, or containers.
"""

from slamcu_eval.scenario.containers import ContainerSystem
from slamcu_eval.scenario.plan import Plan
from slamcu_eval.scenario.processes import ProcessSystem
from slamcu_eval.scenario.story import tell
from slamcu_eval.scenario.system import System, SystemFaultError
from slamcu_eval.scenario.timeline import Timeline

__all__ = [
    "ContainerSystem",
    "Plan",
    "ProcessSystem",
    "System",
    "SystemFaultError",
    "Timeline",
    "tell",
]
