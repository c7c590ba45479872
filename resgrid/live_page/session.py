"""One browser's conversation: every request brings all that it is about, and gets an answer.

Only the last frames are kept, so that a page goes on from where it was when the server is back.
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
from resgrid.live_page.frames import describe, describe_others, probe
from resgrid.live_page.messages import Request, in_page_words, pack, read_drawing, read_request, write_drawing
from resgrid.live_page.opening import example_titles, open_document, open_example, open_files
from resgrid.live_page.solving import SolvedDrawing, WarmFields, solve_drawing

PATIENCE = 0.035
"""Seconds that a direction-safe frame may take to be made while somebody draws."""

_log = logging.getLogger(__name__)
Reply = tuple[dict[str, Any], list[bytes]]


class Session:
    """One browser: answers requests, and keeps its last frame for questions about it."""

    def __init__(self, first: Drawing, read_only: bool) -> None:
        self.first, self.read_only = first, read_only
        self.frame: SolvedDrawing | None = None
        self.settled: SolvedDrawing | None = None
        self.before: SolvedDrawing | None = None
        self.exact_seconds = float("inf")
        self._has_left = self._is_filming = False
        self._newer: Drawing | None = None
        self._warm = WarmFields()

    def hello(self) -> bytes:
        """What a page is told first."""
        head, body = write_drawing(self.first)
        colours = {"height": list(HEIGHT), "goal": GOAL}
        about = {"examples": example_titles(), "read_only": self.read_only, "colours": colours}
        return pack({"hello": about, **head}, body)

    def answer(self, message: bytes) -> bytes:
        """The reply to a message, which says what was wrong with it if anything was."""
        seq: int | None = None
        try:
            request, body = read_request(message)
            seq = request.seq
            head, parts = self._reply(request, body)
        except ResgridError as error:
            head, parts = {"error": in_page_words(str(error)), "kind": type(error).__name__}, []
        except MemoryError:
            head, parts = {"error": "this does not fit in memory; use a coarser grid", "kind": "MemoryError"}, []
        except Exception as error:  # a fault of resgrid, which must not end the conversation
            _log.exception("a request could not be answered")
            head, parts = {"error": f"this is a fault of resgrid ({error!r}); please report it", "kind": "fault"}, []
        return pack({"seq": seq, **head}, *parts)

    def _reply(self, request: Request, body: bytes) -> Reply:
        match request.type:
            case "solve":
                return self._solve(self._drawing(request, body), request.exact)
            case "probe":
                if request.cell is None:
                    raise InputError("this request needs a cell")
                if self.frame is None:
                    raise InputError("nothing has been solved yet")
                told = probe(self.frame, request.cell)
                return {"probe": told | {"pose": pose(self.frame, told["centre"])}}, []
            case "paths":
                return describe_others(self._drawing(request, body), request.paths or ())
            case "settle":
                from resgrid.live_page.settle import settle

                drawing = self._drawing(request, body)
                try:
                    return settle(drawing, self._origin(drawing), lambda: self._is_wanted(drawing))
                finally:
                    self._is_filming = False
            case "save":
                from resgrid.live_page.saving import save

                name, content = save(self._drawing(request, body), request.format)
                return {"name": name}, [content]
        if self.read_only:
            raise InputError("this page is for reading only")
        opened = {
            "world": lambda: resample(read_drawing(request.drawing, body)),
            "example": lambda: drawing_of(open_example(request.name)),
            "files": lambda: open_files(request.files),
            "link": lambda: open_document(request.document),
        }[request.type]()
        head, cells = write_drawing(opened)
        return head, [cells]

    def _drawing(self, request: Request, body: bytes) -> Drawing:
        """What a request is about; for readers the drawing shown, with their own k and starts."""
        drawing = read_drawing(request.drawing, body)
        return replace(self.first, k=drawing.k, starts=drawing.starts) if self.read_only else drawing

    def _origin(self, drawing: Drawing) -> OperatingPoint | None:
        """From where a drawing settles: the circuit before the last change, if it was one and of the same grid."""
        if self.before is None or self.before.drawing.axes != drawing.axes:
            return None
        points = list(self.before.solution.operating_points.values())
        return points[0] if len(points) == 1 else None

    def is_film(self, message: bytes) -> bool:
        """Return whether a message asks for the film of settling, which may take many seconds."""
        head = message[4 : 4 + int.from_bytes(message[:4], "little")]
        if b'"settle"' not in head:  # most messages; a head may hold whole files
            return False
        with suppress(InputError):
            return read_request(message)[0].type == "settle"
        return False

    def begin_film(self) -> None:
        """Let drawings of another circuit that are solved from now on end the film that is asked for next."""
        self._is_filming, self._newer = True, None

    def leave(self) -> None:
        """End a film under way, because nothing waits for it any more."""
        self._has_left = True

    def _is_wanted(self, drawing: Drawing) -> bool:
        """Return whether the film of a drawing is still of the circuit on the page."""
        return not self._has_left and (self._newer is None or is_same_circuit(self._newer, drawing))

    def _solve(self, drawing: Drawing, exact: bool) -> Reply:
        """Solve as asked; in haste, direction-safe all the same where that was quick enough before."""
        if self._is_filming:
            self._newer = drawing
        self.frame = solve_drawing(drawing, exact=exact or self.exact_seconds < PATIENCE, warm=self._warm)
        if self.frame.exact:
            self.exact_seconds = self.frame.seconds
        if exact:  # frames of a gesture under way are no field to settle from
            if self.settled is not None and not is_same_circuit(self.settled.drawing, drawing):
                self.before = self.settled
            self.settled = self.frame
        head, body = describe(self.frame)
        return head | {"poses": poses(self.frame)}, body
