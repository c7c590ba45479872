"""Public names of `resgrid.hardware`."""

from .board import Board as Board, build_board as build_board
from .board_check import check_board as check_board
from .hardware_check import HardwareCheck as HardwareCheck
from .record import HardwareRecord as HardwareRecord, Part as Part, Supply as Supply, read_record as read_record
