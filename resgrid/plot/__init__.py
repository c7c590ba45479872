"""Pictures: every function takes values and an axes, draws, and returns the axes; only `save_figure` writes."""

from resgrid.plot.animations import run_frames, wavefront_frames
from resgrid.plot.chip_curves import plot_bits_histogram, plot_precision_page, plot_served, plot_settling_curve
from resgrid.plot.chips import plot_noise, plot_power, plot_precision, plot_sensitivity, plot_settling
from resgrid.plot.circuits import plot_circuit
from resgrid.plot.control import plot_run, plot_runs_by_k
from resgrid.plot.control_maps import plot_dirichlet_share, plot_settling_sweep, plot_velocities, plot_wavefront
from resgrid.plot.curves import plot_clearance_curve
from resgrid.plot.fields import plot_currents, plot_potential, plot_space
from resgrid.plot.figures import new_figure, render_figure, save_figure
from resgrid.plot.films import save_animation
from resgrid.plot.pages import plot_scene_page
from resgrid.plot.pairs import plot_configurations, plot_pair
from resgrid.plot.paths import plot_path, plot_streamlines
from resgrid.plot.profiles import plot_profile
from resgrid.plot.robots import plot_robot_path, plot_tip_ways, plot_workspace
from resgrid.plot.separations import plot_separation
from resgrid.plot.slices import plot_slices
from resgrid.plot.yields import plot_criticality, plot_exploration, plot_yield

__all__ = [
    "new_figure",
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
    "plot_profile",
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
    "render_figure",
    "run_frames",
    "save_animation",
    "save_figure",
    "wavefront_frames",
]
