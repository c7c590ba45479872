"""The session of one browser: its requests and their replies.

Every request contains the whole drawing, so that a page can continue after a restart of the server.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import replace
from typing import Any

from resgrid._internal.colours import GOAL, HEIGHT
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.errors import InputError, ResgridError
from resgrid.live_page.arms import pose, poses, resample
from resgrid.live_page.drawing import Drawing, drawing_of, is_same_circuit
from resgrid.live_page.examples import example_menu, open_example
from resgrid.live_page.frames import describe, describe_others, probe
from resgrid.live_page.messages import Request, in_page_words, pack, read_drawing, read_request, write_drawing
from resgrid.live_page.opening import open_document, open_files
from resgrid.live_page.solving import SolvedDrawing, WarmFields, solve_drawing

MAX_EXACT_SECONDS = 0.035
"""Limit on the computing time of a direction-safe solution, in seconds, for its use during a mouse gesture.

If the last direction-safe solution took less time, the next solution is direction-safe, too; otherwise a preview (quick
solution with normwise accuracy) is computed during a gesture.
"""

_log = logging.getLogger(__name__)
Reply = tuple[dict[str, Any], list[bytes]]


class Session:
    """Session of one browser, which answers requests and stores the last solved drawings.

    `first`: initial drawing; `read_only`: whether the visitor can only change the Dirichlet weight k and the starts;
    `frame`: last solved drawing; `settled`: last drawing that was solved after a gesture, not during it; `before`: last
    drawing before `settled` that was solved after a gesture and has another circuit, from which a transient starts; all
    three are None at first; `exact_seconds`: computing time of the last direction-safe solution, infinite at first.
    """

    def __init__(self, first: Drawing, read_only: bool) -> None:
        self.first, self.read_only = first, read_only
        self.frame: SolvedDrawing | None = None
        self.settled: SolvedDrawing | None = None
        self.before: SolvedDrawing | None = None
        self.exact_seconds = float("inf")
        self._has_left = self._has_transient = False
        self._newer: Drawing | None = None
        self._warm = WarmFields()

    def hello(self) -> bytes:
        """Return the first message to a page, as bytes: examples, read-only flag, colours, and the initial drawing.

        The colours are those of the colour scale of the potential, and of goals.
        """
        head, body = write_drawing(self.first)
        colours = {"height": list(HEIGHT), "goal": GOAL}
        about = {"examples": example_menu(), "read_only": self.read_only, "colours": colours}
        return pack({"hello": about, **head}, body)

    def answer(self, message: bytes) -> bytes:
        """Return the reply to a message, both as bytes; the reply contains an error message if the request failed."""
        seq: int | None = None
        try:
            request, body = read_request(message)
            seq = request.seq
            head, parts = self._reply(request, body)
        except ResgridError as error:
            head, parts = {"error": in_page_words(str(error)), "kind": type(error).__name__}, []
        except MemoryError:
            head, parts = {"error": "out of memory; use a coarser grid", "kind": "MemoryError"}, []
        except Exception as error:  # an internal error must not end the session
            _log.exception("a request could not be answered")
            head, parts = {"error": f"internal error of resgrid ({error!r}); please report it", "kind": "fault"}, []
        return pack({"seq": seq, **head}, *parts)

    def _reply(self, request: Request, body: bytes) -> Reply:
        match request.type:
            case "solve":
                return self._solve(self._drawing(request, body), request.exact)
            case "probe":
                if request.cell is None:
                    raise InputError("this request needs a cell")
                if self.frame is None:
                    raise InputError("no drawing has been solved yet; send a solve request first")
                properties = probe(self.frame, request.cell)
                return {"probe": properties | {"pose": pose(self.frame, properties["centre"])}}, []
            case "paths":
                return describe_others(self._drawing(request, body), request.paths or ())
            case "settle":
                from resgrid.live_page.settle import settle

                drawing = self._drawing(request, body)
                try:
                    return settle(drawing, self._origin(drawing), lambda: self._is_wanted(drawing))
                finally:
                    self._has_transient = False
            case "save":
                from resgrid.live_page.saving import save

                name, content = save(self._drawing(request, body), request.format)
                return {"name": name}, [content]
        if self.read_only:
            raise InputError("this page is read-only: only k and starts can be changed")
        opened = {
            "world": lambda: resample(read_drawing(request.drawing, body)),
            "example": lambda: drawing_of(open_example(request.name)),
            "files": lambda: open_files(request.files),
            "link": lambda: open_document(request.document),
        }[request.type]()
        head, cells = write_drawing(opened)
        return head, [cells]

    def _drawing(self, request: Request, body: bytes) -> Drawing:
        """Return the drawing of a request; on a read-only page, the initial drawing with the request's k and starts.

        `request`: head of the request; `body`: one byte per cell of the drawing.
        """
        drawing = read_drawing(request.drawing, body)
        return replace(self.first, k=drawing.k, starts=drawing.starts) if self.read_only else drawing

    def _origin(self, drawing: Drawing) -> OperatingPoint | None:
        """Return the operating point before the last change, from which a transient of the drawing starts.

        The result is None if no other circuit was solved before, or if the drawing before the change had other axes or
        a blend of two circuits.
        """
        if self.before is None or self.before.drawing.axes != drawing.axes:
            return None
        points = list(self.before.solution.operating_points.values())
        return points[0] if len(points) == 1 else None

    def requests_transient(self, message: bytes) -> bool:
        """Return whether a message requests a transient, whose computation may take many seconds.

        `message`: the whole message, as bytes.
        """
        head = message[4 : 4 + int.from_bytes(message[:4], "little")]
        if b'"settle"' not in head:  # avoids parsing heads that contain whole files
            return False
        with suppress(InputError):
            return read_request(message)[0].type == "settle"
        return False

    def begin_transient(self) -> None:
        """Record that a transient is being computed, which stops when a drawing of another circuit is solved."""
        self._has_transient, self._newer = True, None

    def leave(self) -> None:
        """Record that the browser has disconnected, which stops the computation of a transient."""
        self._has_left = True

    def _is_wanted(self, drawing: Drawing) -> bool:
        """Return whether a transient is still needed: the browser is connected, and the circuit has not changed.

        `drawing`: drawing whose transient is being computed.
        """
        return not self._has_left and (self._newer is None or is_same_circuit(self._newer, drawing))

    def _solve(self, drawing: Drawing, exact: bool) -> Reply:
        """Return the reply with the solution of a drawing: head (dictionary for JSON) and body (arrays as bytes).

        The head describes field and paths, and has the key ``poses`` (joints of the arm along each path).  `exact`:
        True after a gesture, for a direction-safe solution; False during a gesture, for a preview of normwise accuracy,
        unless the last direction-safe solution took less than 0.035 s.
        """
        if self._has_transient:
            self._newer = drawing
        self.frame = solve_drawing(drawing, exact=exact or self.exact_seconds < MAX_EXACT_SECONDS, warm=self._warm)
        if self.frame.exact:
            self.exact_seconds = self.frame.seconds
        if exact:  # transients do not start from frames during a gesture
            if self.settled is not None and not is_same_circuit(self.settled.drawing, drawing):
                self.before = self.settled
            self.settled = self.frame
        head, body = describe(self.frame)
        return head | {"poses": poses(self.frame)}, body
