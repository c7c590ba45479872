"""Public names of `resgrid.chip`."""

from resgrid.scene.chip import Defects as Defects, Readout as Readout

from . import effects as effects
from .adc_resolution import ADCResolution as ADCResolution
from .build import build_chip as build_chip
from .error_limits import Limit as Limit
from .fault_analysis import FaultAnalysis as FaultAnalysis
from .figures_of_merit import Figure as Figure, Proportion as Proportion
from .noise import Noise as Noise
from .plan_energy import PlanEnergy as PlanEnergy
from .power import Power as Power, RailPower as RailPower
from .sensitivity import Sensitivity as Sensitivity
from .settling import Settling as Settling
from .study_analyses import Study as Study
from .sweeps import Sweep as Sweep
from .yield_loss import Cause as Cause, YieldLoss as YieldLoss
from .yields import Yield as Yield

ANALYSES: tuple[str, ...]
