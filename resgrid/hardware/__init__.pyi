"""Public names of `resgrid.hardware`."""

from .board import Board as Board, build_board as build_board
from .board_check import check_board as check_board
from .hardware_check import HardwareCheck as HardwareCheck
from .layout import Layout as Layout, build_layout as build_layout
from .layout_check import check_layout as check_layout
from .record import HardwareRecord as HardwareRecord, Part as Part, Supply as Supply, read_record as read_record
