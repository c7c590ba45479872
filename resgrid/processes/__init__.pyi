"""Public names of `resgrid.processes`."""

from .process import Cut as Cut, Layer as Layer, Pad as Pad, Process as Process, Resistor as Resistor
from .reading import process_names as process_names, read_process as read_process
