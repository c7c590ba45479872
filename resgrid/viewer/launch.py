"""Start and stop of the 3-D view."""

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
from resgrid.viewer.planning import ArmPlan, require_arm

if TYPE_CHECKING:
    from resgrid.core.space import ConfigurationSpace
    from resgrid.scene.scene import Scene

_HOST = "127.0.0.1"
"""Address of the server: only this computer has access."""

_DIRECTION = np.array([1.0, -1.3, 0.8])
"""Direction from the base of the robot to the camera, as multiples of the robot's reach."""


_CENTRE = np.array([0.0, 0.0, 0.3])
"""Place in the middle of the view relative to the base of the robot, as multiples of the robot's reach."""


class Viewer:
    """A 3-D view of an arm and its server; closed by `close`, by Ctrl-C in `wait`, or at the end of a ``with`` block.

    Attributes
    ----------
    url : str
        Address of the view, to open in a browser.
    """

    def __init__(self, scene: Scene, port: int, space: ConfigurationSpace | None = None) -> None:
        try:
            import viser
        except ImportError as error:
            raise ToolMissingError(f"the 3-D view needs viser; type: {install_command('viewer')} ({error})") from None
        from resgrid.viewer.panel import Panel

        task = ArmPlan(scene, space)
        with _silent():
            self._server = viser.ViserServer(host=_HOST, port=_free_port(port), verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.url = f"http://{_HOST}:{self._server.get_port()}/"
        self._ended = threading.Event()
        self._set_camera(task)
        try:
            self.panel = Panel(self._server, task)
        except BaseException:
            self._stop()
            raise

    def __repr__(self) -> str:
        return f"<Viewer at {self.url}>"

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def _set_camera(self, task: ArmPlan) -> None:
        base = task.robot.tree.placement[0, :3, 3]
        self._server.scene.set_up_direction("+z")
        camera = self._server.initial_camera
        camera.position = tuple(base + _DIRECTION * task.robot.reach)
        camera.look_at = tuple(base + _CENTRE * task.robot.reach)

    def wait(self) -> None:
        """Block until the view is closed, or until the user interrupts the process."""
        while not self._ended.wait(0.5):
            pass

    def close(self) -> None:
        """Stop the server."""
        if not self._ended.is_set():
            self._ended.set()
            self.panel.close()
            self._stop()

    def _stop(self) -> None:
        with _silent():
            self._server.stop()


def view(scene: Scene, *, space: ConfigurationSpace | None = None, port: int = 0, browser: bool = True) -> Viewer:
    """Open a 3-D view of an arm in the browser: links, obstacles, the path with a slider, and handles for its ends.

    A start that changes gives a new streamline; a goal that changes is solved again, without new geometry.  A thread of
    this process serves the view to this computer only.

    Parameters
    ----------
    scene : Scene
        Scene with an arm from a URDF file; its first start is the initial start.
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
        If the robot of the scene is not an arm from a URDF file, or the port is not free.
    ToolMissingError
        If the packages of the extra ``viewer`` are not installed.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/scara.toml")
    >>> with rg.view(scene, browser=False) as view:
    ...     view.url.startswith("http://127.0.0.1:")
    True
    """
    require_arm(scene)
    viewer = Viewer(scene, port, space)
    if browser:
        webbrowser.open(viewer.url)
    return viewer


@contextmanager
def _silent() -> Iterator[None]:
    """Suppress the messages that viser prints by rich at the start and the end of a server."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def _free_port(port: int) -> int:
    """Return a port that is free on this computer: the given one, or any for 0; raise InputError if it is not free."""
    if not 0 <= port <= 65535:
        raise InputError(f"port = {port} must lie between 0 and 65535")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError as error:
            raise InputError(f"port {port} cannot be used ({error.strerror}); choose another one, or 0") from None
        return int(probe.getsockname()[1])
