"""Public names of `resgrid.spice`."""

from . import analyses as analyses
from .check.agreement import Agreement as Agreement
from .check.portability import Prediction as Prediction, check_portability as check_portability
from .circuit import Circuit as Circuit
from .findings import Note as Note, Violation as Violation
from .networks.connectivity import (
    ConnectivityResult as ConnectivityResult,
    run_circuitscape as run_circuitscape,
)
from .power import IrDrop as IrDrop, PowerBalance as PowerBalance, ir_drop as ir_drop, power_balance as power_balance
from .write.files import WrittenDeck as WrittenDeck
from .write.memristive import write_memristive as write_memristive
