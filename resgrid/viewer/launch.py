"""Start and stop of the 3-D view of an arm, a point or a ball on its path: a server, and its page in the browser."""

from __future__ import annotations

import socket
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import rich

from resgrid._internal.extras import install_command
from resgrid.errors import InputError, ToolMissingError
from resgrid.planning.streamline import Streamline
from resgrid.robots import URDFRobot
from resgrid.robots.voxel_surfaces import is_voxel_world
from resgrid.scene.sampling import build_space
from resgrid.viewer.planning import ArmPlan, require_arm
from resgrid.viewer.point_planning import PointPlan

if TYPE_CHECKING:
    from resgrid.core.space import ConfigurationSpace
    from resgrid.scene.scene import Scene

_HOST = "127.0.0.1"
"""Address of the server: only this computer has access."""

_DIRECTION = np.array([1.0, -1.3, 0.8])
"""Vector in world axes from the middle of the view to the initial camera, as a multiple of the view's extent.

The extent is the reach of an arm, or half the diagonal of the grid of a point or a ball.
"""


class Viewer:
    """A 3-D view and its server; closed by `close`, by Ctrl-C in `wait`, or at the end of a ``with`` block.

    Parameters
    ----------
    shown : Scene or Streamline
        Scene with an arm, or with a point or a ball in space; or a path of a point or a ball in space.
    port : int
        Port of the server; 0 for any free port.
    space : ConfigurationSpace, optional
        Space of the scene; by default it is built.

    Attributes
    ----------
    url : str
        Address of the view, to open in a browser.
    """

    def __init__(self, shown: Scene | Streamline, port: int, space: ConfigurationSpace | None = None) -> None:
        try:
            import viser
        except ImportError as error:
            raise ToolMissingError(f"the 3-D view needs viser; type: {install_command('viewer')} ({error})") from None
        from resgrid.viewer.panel import ControlPanel

        task = _task(shown, space)
        with _silent():
            self._server = viser.ViserServer(host=_HOST, port=_free_port(port), verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.url = f"http://{_HOST}:{self._server.get_port()}/"
        self._ended = threading.Event()
        self._set_camera(task)
        try:
            self.panel = ControlPanel(self._server, task)
        except BaseException:
            self._stop()
            raise

    def __repr__(self) -> str:
        return f"<Viewer at {self.url}>"

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def _set_camera(self, task: ArmPlan | PointPlan) -> None:
        self._server.scene.set_up_direction("+z")
        camera = self._server.initial_camera
        camera.position = tuple(task.centre + _DIRECTION * task.size)
        camera.look_at = tuple(task.centre)

    def wait(self) -> None:
        """Block until the view is closed, or until Ctrl-C, which closes the view."""
        while not self._ended.wait(0.5):
            pass

    def close(self) -> None:
        """Stop the threads that plan and play, and the server."""
        if not self._ended.is_set():
            self._ended.set()
            self.panel.close()
            self._stop()

    def _stop(self) -> None:
        with _silent():
            self._server.stop()


def view(
    shown: Scene | Streamline, *, space: ConfigurationSpace | None = None, port: int = 0, browser: bool = True
) -> Viewer:
    """Open a 3-D view in the browser: obstacles, the robot on its path with a slider, and handles for start and goal.

    A new start gives a new streamline; for a new goal the circuit is solved again, with the same obstacles.  Obstacles
    of a point or a ball in space are shown as the surface of their cells.  A thread of this process serves the view to
    this computer only.

    Parameters
    ----------
    shown : Scene or Streamline
        Scene with an arm from a URDF file, or with a point or a ball in space; its first start is the initial start.
        Or a path of a point or a ball in space.
    space : ConfigurationSpace, optional
        Result of `build_space` for the scene; by default it is computed, or loaded from the cache.
    port : int
        Port of the server; 0 for any free port.
    browser : bool
        Whether to open the view in a browser.

    Returns
    -------
    Viewer
        The view; its ``url`` is the address.

    Raises
    ------
    InputError
        If the robot is neither an arm from a URDF file nor a point or ball in space, or the port is not free.
    ToolMissingError
        If the packages of the extra ``viewer`` are not installed.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/scara.toml")
    >>> with rg.view(scene, browser=False) as view:
    ...     view.url.startswith("http://127.0.0.1:")
    True
    """
    if isinstance(shown, Streamline):
        _require_voxel_world(shown.space)
    elif not shown.robot.moves_in_workspace:
        require_arm(shown)
    else:
        space = build_space(shown) if space is None else space
        _require_voxel_world(space)
    viewer = Viewer(shown, port, space)
    if browser:
        webbrowser.open(viewer.url)
    return viewer


def _require_voxel_world(space: ConfigurationSpace) -> None:
    if not is_voxel_world(space):
        raise InputError(
            "the 3-D view shows arms from URDF files, and points and balls in space; this robot is neither: use "
            "live(scene), or draw(path)"
        )


def _task(shown: Scene | Streamline, space: ConfigurationSpace | None) -> ArmPlan | PointPlan:
    """Solve the space that a view shows, and return the space with start and goal.

    `shown`: scene, or path of a point or a ball; `space`: space of the scene, None to build it.
    """
    if isinstance(shown, Streamline):
        return PointPlan.of_path(shown)
    return ArmPlan(shown, space) if isinstance(shown.robot, URDFRobot) else PointPlan.of_scene(shown, space)


@contextmanager
def _silent() -> Iterator[None]:
    """Suppress the messages that viser prints when a server starts or stops."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def _free_port(port: int) -> int:
    """Return a free port of this computer: the given port, or any free port for 0.

    Raises InputError if the given port is in use or out of range.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"port = {port} must lie between 0 and 65535")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError as error:
            raise InputError(f"port {port} cannot be used ({error.strerror}); choose another one, or 0") from None
        return int(probe.getsockname()[1])
