"""Public names of `resgrid.hardware`."""

from resgrid.hardware.hardware_check import HardwareCheck as HardwareCheck
from resgrid.hardware.layout import Layout as Layout, build_layout as build_layout
from resgrid.hardware.layout_check import check_layout as check_layout
