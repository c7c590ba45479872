"""Public names of `resgrid.hardware`."""

from resgrid.hardware.layout import Layout as Layout, build_layout as build_layout
