"""What each part of the filter is worth: the same drives with one part at a time switched off or as printed."""

from slamcu_eval.ablation.experiment import Cell, run_ablation
from slamcu_eval.ablation.figures import ablation_figures
from slamcu_eval.ablation.variants import FULL, VARIANTS, Variant

__all__ = ["FULL", "VARIANTS", "Cell", "Variant", "ablation_figures", "run_ablation"]
