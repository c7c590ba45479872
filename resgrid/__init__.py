"""Plan robot motions with a grid of resistors.

    a robot and its surroundings -> configuration space -> resistor netlist -> operating point -> field -> path

>>> import numpy as np
>>> import resgrid as rg
>>> cell = np.zeros((8, 8), dtype=np.uint8)
>>> cell[1:5, 4], cell[6, 1] = rg.Cell.OBSTACLE, rg.Cell.GOAL
>>> space = rg.ConfigurationSpace([rg.Axis("x", 0, 8, 8), rg.Axis("y", 0, 8, 8)], cell)
>>> field = rg.field(rg.solve(rg.compile_space(space)))
>>> str(rg.streamline(field, start=(0.5, 6.5)).outcome)
'reached'

Names are imported when they are first used, so that ``import resgrid`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from resgrid.compiler import compile_space
    from resgrid.control.controller import Controller, make_controller
    from resgrid.control.equipotential import equipotential_velocity
    from resgrid.control.fronts import Wavefront, wavefront
    from resgrid.control.log import Ending, Mode, Run
    from resgrid.control.plant import Plant, make_plant
    from resgrid.control.pushes import Push, random_pushes
    from resgrid.control.settling import GridSettling, grid_settling
    from resgrid.control.settling_ratio import SettlingSweep, announced, settling_sweep
    from resgrid.control.simulation import Simulation, simulation
    from resgrid.device.build import build_chip, compile_chip, conductance_samples, mismatch_factors
    from resgrid.device.criticality import Criticality, analyse_criticality
    from resgrid.device.decks import write_chip_decks
    from resgrid.device.exploration import Exploration, chip_with, explore_yield
    from resgrid.device.ideal import ideal_netlist
    from resgrid.device.noise import Noise, analyse_noise, noise_covariance, noise_density
    from resgrid.device.passes import apply_passes, passes_from_json, passes_of, passes_to_json
    from resgrid.device.power import Power, analyse_power
    from resgrid.device.precision import Precision, analyse_precision
    from resgrid.device.proportions import Proportion
    from resgrid.device.sensitivity import Sensitivity, analyse_sensitivity, voltage_sensitivity
    from resgrid.device.settling import Settling, analyse_settling
    from resgrid.device.yields import Yield, analyse_yield
    from resgrid.errors import (
        AccuracyError,
        BudgetError,
        CertificateError,
        CircuitError,
        InputError,
        ResgridError,
        ToolMissingError,
    )
    from resgrid.netlist import Layout, Netlist
    from resgrid.nodal.batch.many import solve_many
    from resgrid.nodal.drive import scale_drive
    from resgrid.nodal.operating_point import OperatingPoint
    from resgrid.nodal.secant import small_signal
    from resgrid.nodal.solve import factor, solve
    from resgrid.nodal.transient import Transient, TransientStepper, transient, transient_stepper
    from resgrid.nodal.watch import Watch
    from resgrid.planning.behaviour import ClearanceCurve, clearance_curve, wall_clearance_curve
    from resgrid.planning.blend import blend
    from resgrid.planning.certify import certify
    from resgrid.planning.collision import Risk, risk
    from resgrid.planning.completeness import Separation, check_verdicts, separation
    from resgrid.planning.destinations import Absorption, absorption, basins
    from resgrid.planning.export import ros_plan, write_path
    from resgrid.planning.field import Field
    from resgrid.planning.field import field_of as field
    from resgrid.planning.free_way import certify_free
    from resgrid.planning.normals import octree_voxels, surface_normals
    from resgrid.planning.planner import Planner, plan
    from resgrid.planning.scene_parts import Blocking, blocking
    from resgrid.planning.seams import unwrap
    from resgrid.planning.shares import dirichlet_share
    from resgrid.planning.short_path import ShortPath
    from resgrid.planning.shortcut import shorten
    from resgrid.planning.streamline import Outcome, Streamline
    from resgrid.planning.timing import time_path
    from resgrid.planning.trace import Traces, streamline, streamlines
    from resgrid.planning.trajectory import Trajectory
    from resgrid.planning.walk import Walk, random_walk
    from resgrid.planning.workspace import Collision, replay, workspace_clearance, workspace_path
    from resgrid.plot import (
        plot_bits_histogram,
        plot_circuit,
        plot_clearance_curve,
        plot_configurations,
        plot_criticality,
        plot_currents,
        plot_dirichlet_share,
        plot_exploration,
        plot_noise,
        plot_pair,
        plot_path,
        plot_potential,
        plot_power,
        plot_precision,
        plot_precision_page,
        plot_robot_path,
        plot_run,
        plot_runs_by_k,
        plot_scene_page,
        plot_sensitivity,
        plot_separation,
        plot_served,
        plot_settling,
        plot_settling_curve,
        plot_settling_sweep,
        plot_slices,
        plot_space,
        plot_streamlines,
        plot_tip_ways,
        plot_velocities,
        plot_wavefront,
        plot_workspace,
        plot_yield,
        run_frames,
        save_animation,
        save_figure,
        wavefront_frames,
    )
    from resgrid.robots import Arm, DiscRobot, PointRobot, PolygonRobot
    from resgrid.scene import (
        Chip,
        Defects,
        Readout,
        Scene,
        apply_overrides,
        free_volume_lost,
        occupancy_grid,
        parse_quantity,
        parse_scene,
        read_queries,
        read_scene,
        sample,
        scene_schema,
    )
    from resgrid.space import Axis, Cell, ConfigurationSpace
    from resgrid.spice.agreement import Agreement, check_deck, check_spice
    from resgrid.spice.analyses import (
        Measure,
        MismatchAnalysis,
        NoiseAnalysis,
        OperatingAnalysis,
        Probe,
        TemperatureAnalysis,
        TransientAnalysis,
    )
    from resgrid.spice.balance import PowerBalance, power_balance
    from resgrid.spice.deck import format_deck
    from resgrid.spice.drops import Drops, supply_drops
    from resgrid.spice.finding import Finding
    from resgrid.spice.forecast import Forecast, forecast_run
    from resgrid.spice.ngspice import run_ngspice
    from resgrid.spice.parsed import Note, ParsedDeck
    from resgrid.spice.rawwriter import write_raw
    from resgrid.spice.reader import read_network, read_spice
    from resgrid.spice.rules import check_rules
    from resgrid.spice.tiles import Tile, expanded_netlist
    from resgrid.spice.verdicts import Verdict, predict_simulators
    from resgrid.spice.writer import write_spice

_HOME = {
    "Yield": "resgrid.device.yields",
    "analyse_yield": "resgrid.device.yields",
    "Exploration": "resgrid.device.exploration",
    "explore_yield": "resgrid.device.exploration",
    "chip_with": "resgrid.device.exploration",
    "Criticality": "resgrid.device.criticality",
    "analyse_criticality": "resgrid.device.criticality",
    "Proportion": "resgrid.device.proportions",
    "ideal_netlist": "resgrid.device.ideal",
    "write_chip_decks": "resgrid.device.decks",
    "plot_criticality": "resgrid.plot",
    "plot_exploration": "resgrid.plot",
    "plot_yield": "resgrid.plot",
    "plot_bits_histogram": "resgrid.plot",
    "plot_noise": "resgrid.plot",
    "plot_power": "resgrid.plot",
    "plot_precision": "resgrid.plot",
    "plot_precision_page": "resgrid.plot",
    "plot_sensitivity": "resgrid.plot",
    "plot_served": "resgrid.plot",
    "plot_settling": "resgrid.plot",
    "plot_settling_curve": "resgrid.plot",
    "Sensitivity": "resgrid.device.sensitivity",
    "analyse_sensitivity": "resgrid.device.sensitivity",
    "voltage_sensitivity": "resgrid.device.sensitivity",
    "Precision": "resgrid.device.precision",
    "analyse_precision": "resgrid.device.precision",
    "Power": "resgrid.device.power",
    "analyse_power": "resgrid.device.power",
    "Settling": "resgrid.device.settling",
    "analyse_settling": "resgrid.device.settling",
    "Noise": "resgrid.device.noise",
    "analyse_noise": "resgrid.device.noise",
    "noise_covariance": "resgrid.device.noise",
    "noise_density": "resgrid.device.noise",
    "compile_space": "resgrid.compiler",
    "Controller": "resgrid.control.controller",
    "make_controller": "resgrid.control.controller",
    "equipotential_velocity": "resgrid.control.equipotential",
    "Ending": "resgrid.control.log",
    "Mode": "resgrid.control.log",
    "Run": "resgrid.control.log",
    "Plant": "resgrid.control.plant",
    "make_plant": "resgrid.control.plant",
    "Push": "resgrid.control.pushes",
    "random_pushes": "resgrid.control.pushes",
    "Simulation": "resgrid.control.simulation",
    "simulation": "resgrid.control.simulation",
    "wavefront_frames": "resgrid.plot",
    "save_animation": "resgrid.plot",
    "run_frames": "resgrid.plot",
    "plot_wavefront": "resgrid.plot",
    "plot_velocities": "resgrid.plot",
    "plot_settling_sweep": "resgrid.plot",
    "plot_dirichlet_share": "resgrid.plot",
    "plot_runs_by_k": "resgrid.plot",
    "plot_run": "resgrid.plot",
    "dirichlet_share": "resgrid.planning.shares",
    "settling_sweep": "resgrid.control.settling_ratio",
    "announced": "resgrid.control.settling_ratio",
    "SettlingSweep": "resgrid.control.settling_ratio",
    "wavefront": "resgrid.control.fronts",
    "Wavefront": "resgrid.control.fronts",
    "grid_settling": "resgrid.control.settling",
    "GridSettling": "resgrid.control.settling",
    "build_chip": "resgrid.device.build",
    "compile_chip": "resgrid.device.build",
    "conductance_samples": "resgrid.device.build",
    "mismatch_factors": "resgrid.device.build",
    "apply_passes": "resgrid.device.passes",
    "passes_from_json": "resgrid.device.passes",
    "passes_of": "resgrid.device.passes",
    "passes_to_json": "resgrid.device.passes",
    "AccuracyError": "resgrid.errors",
    "BudgetError": "resgrid.errors",
    "CertificateError": "resgrid.errors",
    "CircuitError": "resgrid.errors",
    "InputError": "resgrid.errors",
    "ResgridError": "resgrid.errors",
    "ToolMissingError": "resgrid.errors",
    "Layout": "resgrid.netlist",
    "Netlist": "resgrid.netlist",
    "solve_many": "resgrid.nodal.batch.many",
    "scale_drive": "resgrid.nodal.drive",
    "OperatingPoint": "resgrid.nodal.operating_point",
    "small_signal": "resgrid.nodal.secant",
    "factor": "resgrid.nodal.solve",
    "solve": "resgrid.nodal.solve",
    "Transient": "resgrid.nodal.transient",
    "TransientStepper": "resgrid.nodal.transient",
    "transient": "resgrid.nodal.transient",
    "transient_stepper": "resgrid.nodal.transient",
    "Watch": "resgrid.nodal.watch",
    "Blocking": "resgrid.planning.scene_parts",
    "blocking": "resgrid.planning.scene_parts",
    "Walk": "resgrid.planning.walk",
    "random_walk": "resgrid.planning.walk",
    "Risk": "resgrid.planning.collision",
    "risk": "resgrid.planning.collision",
    "Absorption": "resgrid.planning.destinations",
    "absorption": "resgrid.planning.destinations",
    "basins": "resgrid.planning.destinations",
    "Separation": "resgrid.planning.completeness",
    "check_verdicts": "resgrid.planning.completeness",
    "separation": "resgrid.planning.completeness",
    "Planner": "resgrid.planning.planner",
    "plan": "resgrid.planning.planner",
    "ClearanceCurve": "resgrid.planning.behaviour",
    "clearance_curve": "resgrid.planning.behaviour",
    "wall_clearance_curve": "resgrid.planning.behaviour",
    "surface_normals": "resgrid.planning.normals",
    "octree_voxels": "resgrid.planning.normals",
    "blend": "resgrid.planning.blend",
    "certify": "resgrid.planning.certify",
    "Field": "resgrid.planning.field",
    "field": "resgrid.planning.field",
    "Outcome": "resgrid.planning.streamline",
    "Streamline": "resgrid.planning.streamline",
    "Traces": "resgrid.planning.trace",
    "streamline": "resgrid.planning.trace",
    "streamlines": "resgrid.planning.trace",
    "ros_plan": "resgrid.planning.export",
    "write_path": "resgrid.planning.export",
    "certify_free": "resgrid.planning.free_way",
    "unwrap": "resgrid.planning.seams",
    "ShortPath": "resgrid.planning.short_path",
    "shorten": "resgrid.planning.shortcut",
    "time_path": "resgrid.planning.timing",
    "Trajectory": "resgrid.planning.trajectory",
    "Collision": "resgrid.planning.workspace",
    "replay": "resgrid.planning.workspace",
    "workspace_clearance": "resgrid.planning.workspace",
    "workspace_path": "resgrid.planning.workspace",
    "plot_clearance_curve": "resgrid.plot",
    "plot_configurations": "resgrid.plot",
    "plot_pair": "resgrid.plot",
    "plot_robot_path": "resgrid.plot",
    "plot_separation": "resgrid.plot",
    "plot_tip_ways": "resgrid.plot",
    "plot_workspace": "resgrid.plot",
    "plot_circuit": "resgrid.plot",
    "plot_currents": "resgrid.plot",
    "plot_path": "resgrid.plot",
    "plot_potential": "resgrid.plot",
    "plot_scene_page": "resgrid.plot",
    "plot_slices": "resgrid.plot",
    "plot_space": "resgrid.plot",
    "plot_streamlines": "resgrid.plot",
    "save_figure": "resgrid.plot",
    "Arm": "resgrid.robots",
    "DiscRobot": "resgrid.robots",
    "PointRobot": "resgrid.robots",
    "PolygonRobot": "resgrid.robots",
    "Chip": "resgrid.scene",
    "Defects": "resgrid.scene",
    "Readout": "resgrid.scene",
    "Scene": "resgrid.scene",
    "apply_overrides": "resgrid.scene",
    "free_volume_lost": "resgrid.scene",
    "occupancy_grid": "resgrid.scene",
    "parse_quantity": "resgrid.scene",
    "parse_scene": "resgrid.scene",
    "read_queries": "resgrid.scene",
    "read_scene": "resgrid.scene",
    "sample": "resgrid.scene",
    "scene_schema": "resgrid.scene",
    "Axis": "resgrid.space",
    "Cell": "resgrid.space",
    "ConfigurationSpace": "resgrid.space",
    "Agreement": "resgrid.spice.agreement",
    "check_deck": "resgrid.spice.agreement",
    "check_spice": "resgrid.spice.agreement",
    "format_deck": "resgrid.spice.deck",
    "run_ngspice": "resgrid.spice.ngspice",
    "Note": "resgrid.spice.parsed",
    "ParsedDeck": "resgrid.spice.parsed",
    "read_network": "resgrid.spice.reader",
    "read_spice": "resgrid.spice.reader",
    "PowerBalance": "resgrid.spice.balance",
    "power_balance": "resgrid.spice.balance",
    "Drops": "resgrid.spice.drops",
    "supply_drops": "resgrid.spice.drops",
    "Finding": "resgrid.spice.finding",
    "Forecast": "resgrid.spice.forecast",
    "forecast_run": "resgrid.spice.forecast",
    "write_raw": "resgrid.spice.rawwriter",
    "check_rules": "resgrid.spice.rules",
    "Verdict": "resgrid.spice.verdicts",
    "predict_simulators": "resgrid.spice.verdicts",
    "Measure": "resgrid.spice.analyses",
    "MismatchAnalysis": "resgrid.spice.analyses",
    "NoiseAnalysis": "resgrid.spice.analyses",
    "OperatingAnalysis": "resgrid.spice.analyses",
    "Probe": "resgrid.spice.analyses",
    "TemperatureAnalysis": "resgrid.spice.analyses",
    "TransientAnalysis": "resgrid.spice.analyses",
    "Tile": "resgrid.spice.tiles",
    "expanded_netlist": "resgrid.spice.tiles",
    "write_spice": "resgrid.spice.writer",
}
"""Where every public name lives."""

_OTHER_NAME = {"field": "field_of"}

__all__ = [
    "Absorption",
    "AccuracyError",
    "Agreement",
    "Arm",
    "Axis",
    "Blocking",
    "BudgetError",
    "Cell",
    "CertificateError",
    "Chip",
    "CircuitError",
    "ClearanceCurve",
    "Collision",
    "ConfigurationSpace",
    "Controller",
    "Criticality",
    "Defects",
    "DiscRobot",
    "Drops",
    "Ending",
    "Exploration",
    "Field",
    "Finding",
    "Forecast",
    "GridSettling",
    "InputError",
    "Layout",
    "Measure",
    "MismatchAnalysis",
    "Mode",
    "Netlist",
    "Noise",
    "NoiseAnalysis",
    "Note",
    "OperatingAnalysis",
    "OperatingPoint",
    "Outcome",
    "ParsedDeck",
    "Planner",
    "Plant",
    "PointRobot",
    "PolygonRobot",
    "Power",
    "PowerBalance",
    "Precision",
    "Probe",
    "Proportion",
    "Push",
    "Readout",
    "ResgridError",
    "Risk",
    "Run",
    "Scene",
    "Sensitivity",
    "Separation",
    "Settling",
    "SettlingSweep",
    "ShortPath",
    "Simulation",
    "Streamline",
    "TemperatureAnalysis",
    "Tile",
    "ToolMissingError",
    "Traces",
    "Trajectory",
    "Transient",
    "TransientAnalysis",
    "TransientStepper",
    "Verdict",
    "Walk",
    "Watch",
    "Wavefront",
    "Yield",
    "__version__",
    "absorption",
    "analyse_criticality",
    "analyse_noise",
    "analyse_power",
    "analyse_precision",
    "analyse_sensitivity",
    "analyse_settling",
    "analyse_yield",
    "announced",
    "apply_overrides",
    "apply_passes",
    "basins",
    "blend",
    "blocking",
    "build_chip",
    "certify",
    "certify_free",
    "check_deck",
    "check_rules",
    "check_spice",
    "check_verdicts",
    "chip_with",
    "clearance_curve",
    "compile_chip",
    "compile_space",
    "conductance_samples",
    "dirichlet_share",
    "equipotential_velocity",
    "expanded_netlist",
    "explore_yield",
    "factor",
    "field",
    "forecast_run",
    "format_deck",
    "free_volume_lost",
    "grid_settling",
    "ideal_netlist",
    "make_controller",
    "make_plant",
    "mismatch_factors",
    "noise_covariance",
    "noise_density",
    "occupancy_grid",
    "octree_voxels",
    "parse_quantity",
    "parse_scene",
    "passes_from_json",
    "passes_of",
    "passes_to_json",
    "plan",
    "plot_bits_histogram",
    "plot_circuit",
    "plot_clearance_curve",
    "plot_configurations",
    "plot_criticality",
    "plot_currents",
    "plot_dirichlet_share",
    "plot_exploration",
    "plot_noise",
    "plot_pair",
    "plot_path",
    "plot_potential",
    "plot_power",
    "plot_precision",
    "plot_precision_page",
    "plot_robot_path",
    "plot_run",
    "plot_runs_by_k",
    "plot_scene_page",
    "plot_sensitivity",
    "plot_separation",
    "plot_served",
    "plot_settling",
    "plot_settling_curve",
    "plot_settling_sweep",
    "plot_slices",
    "plot_space",
    "plot_streamlines",
    "plot_tip_ways",
    "plot_velocities",
    "plot_wavefront",
    "plot_workspace",
    "plot_yield",
    "power_balance",
    "predict_simulators",
    "random_pushes",
    "random_walk",
    "read_network",
    "read_queries",
    "read_scene",
    "read_spice",
    "replay",
    "risk",
    "ros_plan",
    "run_frames",
    "run_ngspice",
    "sample",
    "save_animation",
    "save_figure",
    "scale_drive",
    "scene_schema",
    "separation",
    "settling_sweep",
    "shorten",
    "simulation",
    "small_signal",
    "solve",
    "solve_many",
    "streamline",
    "streamlines",
    "supply_drops",
    "surface_normals",
    "time_path",
    "transient",
    "transient_stepper",
    "unwrap",
    "voltage_sensitivity",
    "wall_clearance_curve",
    "wavefront",
    "wavefront_frames",
    "workspace_clearance",
    "workspace_path",
    "write_chip_decks",
    "write_path",
    "write_raw",
    "write_spice",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name not in _HOME:
        raise AttributeError(f"module 'resgrid' has no attribute {name!r}; it has {', '.join(sorted(_HOME))}")
    value = getattr(import_module(_HOME[name]), _OTHER_NAME.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("resgrid")
    except PackageNotFoundError:  # used from a source tree that was never installed
        return "0+unknown"
