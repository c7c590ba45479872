"""Changes of KiCad boards that each make one fault, with the words that a report of this fault must contain."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from shapely import LineString, MultiLineString, Point, Polygon, union_all

Tree = list[Any]
Place = tuple[str, ...]
"""Words that one finding must contain."""

_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[()]|[^\s()"]+')


def parse(text: str) -> Tree:
    """The S-expression of a text: nested lists of tokens, texts with their quotes."""
    stack: list[Tree] = [[]]
    for token in _TOKEN.findall(text):
        if token == "(":
            stack.append([])
        elif token == ")":
            stack[-2].append(stack.pop())
        else:
            stack[-1].append(token)
    return stack[0][0]


def dump(tree: Any) -> str:
    """The text of an S-expression, a list per line: KiCad reads no line of more than a million characters."""
    return f"({' '.join(map(dump, tree))})\n" if isinstance(tree, list) else tree


def sub(tree: Tree, key: str) -> Tree:
    """The first list with a keyword."""
    return next(subs(tree, key))


def subs(tree: Tree, key: str) -> Iterator[Tree]:
    return (entry for entry in tree if isinstance(entry, list) and entry and entry[0] == key)


def numbers(tree: Tree) -> list[float]:
    return [float(token) for token in tree[1:]]


@dataclass
class Project:
    """A board folder whose files are changed: the board, and the schematic sheets by name."""

    board: Tree
    sheets: dict[str, Tree]
    draw: random.Random = field(default_factory=random.Random)

    @classmethod
    def read(cls, folder: Path, seed: int) -> Project:
        (board,) = folder.glob("*.kicad_pcb")
        sheets = {file.name: parse(file.read_text()) for file in sorted(folder.glob("*.kicad_sch"))}
        return cls(parse(board.read_text()), sheets, random.Random(seed))

    def write(self, folder: Path) -> None:
        (board,) = folder.glob("*.kicad_pcb")
        board.write_text(dump(self.board) + "\n")
        for name, sheet in self.sheets.items():
            (folder / name).write_text(dump(sheet) + "\n")

    @property
    def net_names(self) -> dict[str, str]:
        return {net[1]: net[2].strip('"') for net in subs(self.board, "net")}

    def net(self, item: Tree) -> str:
        """The net of a track, via, zone or pad."""
        net = sub(item, "net")
        return self.net_names[net[1]] if net[1] in self.net_names else net[1].strip('"')

    @property
    def resistors(self) -> list[Tree]:
        return [part for part in subs(self.board, "footprint") if re.fullmatch(r"R\d+", reference(part))]

    def tracks(self) -> list[Tree]:
        """Tracks of nets of cells, of at least 1 mm."""
        return [
            track for track in subs(self.board, "segment") if self.net(track).startswith("n_") and length(track) > 1
        ]

    def only_via(self, net: str = "") -> Tree:
        """A via, on a given net or on any, that alone connects tracks of the front with the back."""
        vias = [via for via in subs(self.board, "via") if self.net(via) == net or not net]
        self.draw.shuffle(vias)
        return next(via for via in vias if _is_only_hole(self, via))

    def symbol(self, name: str) -> tuple[Tree, Tree]:
        """The sheet and the symbol with a reference."""
        return next(
            (sheet, symbol)
            for sheet in self.sheets.values()
            for symbol in subs(sheet, "symbol")
            if value_of(symbol, "Reference") == name
        )


def reference(part: Tree) -> str:
    return value_of(part, "Reference")


def value_of(part: Tree, name: str) -> str:
    return next((entry[2].strip('"') for entry in subs(part, "property") if entry[1] == f'"{name}"'), "")


def set_value(part: Tree, value: str) -> None:
    next(entry for entry in subs(part, "property") if entry[1] == '"Value"')[2] = f'"{value}"'


def length(track: Tree) -> float:
    return math.dist(numbers(sub(track, "start")), numbers(sub(track, "end")))


def place_of(part: Tree, pad: Tree) -> tuple[float, float]:
    """The place of a pad on the board."""
    x, y, turn = (*numbers(sub(part, "at")), 0.0)[:3]
    a, b = numbers(sub(pad, "at"))[:2]
    angle = math.radians(turn)
    return x + a * math.cos(angle) + b * math.sin(angle), y - a * math.sin(angle) + b * math.cos(angle)


def move(part: Tree, dx: float, dy: float) -> None:
    at = sub(part, "at")
    at[1:3] = [str(float(at[1]) + dx), str(float(at[2]) + dy)]


def turn(part: Tree, degrees: int) -> None:
    """Turn a footprint; angles of pads in a board file include that of the footprint."""
    for at in (sub(part, "at"), *(sub(pad, "at") for pad in subs(part, "pad"))):
        at[3:] = [str((int(float(at[3])) if len(at) > 3 else 0) + degrees)]


def add_track(project: Project, net: Tree, points: list[tuple[float, float]]) -> None:
    for start, end in pairwise(points):
        ends = ["start", *map(str, start)], ["end", *map(str, end)]
        project.board.append(["segment", *ends, ["width", "0.25"], ["layer", '"F.Cu"'], net[:2]])


def swap_two_tracks(project: Project) -> list[Place]:
    """Let two tracks of different nets end at each other's end."""
    first = project.draw.choice(project.tracks())
    second = project.draw.choice([track for track in project.tracks() if project.net(track) != project.net(first)])
    a, b = sub(first, "end"), sub(second, "end")
    a[1:], b[1:] = b[1:], a[1:]
    return [(project.net(first),), (project.net(second),)]


def delete_a_track(project: Project) -> list[Place]:
    track = project.draw.choice(project.tracks())
    project.board.remove(track)
    return [(project.net(track), "is split in")]


def shorten_a_track(project: Project) -> list[Place]:
    """Leave a gap in the middle of a track."""
    track = project.draw.choice(project.tracks())
    start, end = sub(track, "start"), sub(track, "end")
    x = [a + (b - a) * 0.4 for a, b in zip(numbers(start), numbers(end), strict=True)]
    end[1:] = map(str, x)
    return [(project.net(track), "is split in")]


def delete_a_via(project: Project) -> list[Place]:
    """Delete a via that alone connects tracks of the front with the back."""
    via = project.only_via()
    project.board.remove(via)
    return [(project.net(via),)]


def _is_only_hole(project: Project, via: Tree) -> bool:
    """Whether the tracks of the front that touch a via lead to no other hole."""
    net = project.net(via)
    tracks = [
        LineString([numbers(sub(track, "start")), numbers(sub(track, "end"))])
        for track in subs(project.board, "segment")
        if project.net(track) == net and sub(track, "layer")[1] == '"F.Cu"'
    ]
    holes = [Point(numbers(sub(other, "at"))) for other in subs(project.board, "via") if other is not via]
    holes += [
        Point(place_of(part, pad))
        for part in subs(project.board, "footprint")
        for pad in subs(part, "pad")
        if pad[2] == "thru_hole"
    ]
    reached: Any = Point(numbers(sub(via, "at")))
    rest = tracks
    while near := [track for track in rest if track.distance(reached) < 1e-3]:
        rest = [track for track in rest if track not in near]
        reached = reached.union(MultiLineString(near))
    return len(rest) < len(tracks) and all(hole.distance(reached) > 1e-3 for hole in holes)


def move_a_part(project: Project) -> list[Place]:
    """Move a resistor by the distance of two cells."""
    part = project.draw.choice(project.resistors)
    move(part, *project.draw.choice([(5.08, 0.0), (-5.08, 0.0), (0.0, 5.08), (0.0, -5.08)]))
    return [(reference(part),)]


def shift_a_part(project: Project) -> list[Place]:
    """Shift a resistor sideways until its pads leave its tracks."""
    part = project.draw.choice(project.resistors)
    sideways = len(numbers(sub(part, "at"))) < 3 or numbers(sub(part, "at"))[2] % 180 == 0
    move(part, *((0.0, 1.6) if sideways else (1.6, 0.0)))
    return [(reference(part),)]


def turn_a_part(project: Project) -> list[Place]:
    part = project.draw.choice(project.resistors)
    turn(part, 90)
    return [(reference(part),)]


def turn_a_part_around(project: Project) -> list[Place]:
    part = project.draw.choice(project.resistors)
    turn(part, 180)
    return [(reference(part),)]


def omit_a_part(project: Project) -> list[Place]:
    part = project.draw.choice(project.resistors)
    project.board.remove(part)
    return [(reference(part), "missing")]


def exchange_two_parts(project: Project) -> list[Place]:
    """Let two resistors take each other's place."""
    first, second = project.draw.sample(project.resistors, 2)
    a, b = sub(first, "at"), sub(second, "at")
    turn_a = int(float([*a, "0"][3])) - int(float([*b, "0"][3]))
    a[1:3], b[1:3] = b[1:3], a[1:3]
    turn(first, -turn_a)
    turn(second, turn_a)
    return [(reference(first),), (reference(second),)]


def change_a_value_on_the_board(project: Project) -> list[Place]:
    part = project.draw.choice(project.resistors)
    set_value(part, "10.5k")
    return [(reference(part), "10500 ohm")]


def change_a_value_in_the_schematic(project: Project) -> list[Place]:
    name = reference(project.draw.choice(project.resistors))
    set_value(project.symbol(name)[1], "10.5k")
    return [(name, "10500 ohm")]


def omit_a_symbol(project: Project) -> list[Place]:
    name = reference(project.draw.choice(project.resistors))
    sheet, symbol = project.symbol(name)
    sheet.remove(symbol)
    return [(name, "missing")]


def state_a_wrong_net(project: Project) -> list[Place]:
    """State the net of another part for one pad."""
    part = project.draw.choice(project.resistors)
    pad = project.draw.choice(list(subs(part, "pad")))
    own = project.net(pad)
    others = [
        net for net in subs(project.board, "net") if net[2].strip('"').startswith("n_") and net[2].strip('"') != own
    ]
    other = project.draw.choice(others)
    sub(pad, "net")[1:] = other[1:] if len(sub(pad, "net")) > 2 else other[2:]
    return [(f"{reference(part)}: pad {pad[1].strip(chr(34))}", other[2].strip('"'))]


def bridge_two_pads(project: Project) -> list[Place]:
    """Connect both pads of a resistor by a track."""
    part = project.draw.choice(project.resistors)
    first, second = subs(part, "pad")
    number = {name: number for number, name in project.net_names.items()}
    net = ["net", number[project.net(first)]]
    add_track(project, net, [place_of(part, first), place_of(part, second)])
    return [(project.net(first), project.net(second), "short circuit", " at (")]


def drill_through_a_track(project: Project) -> list[Place]:
    """Add a hole without copper in the middle of a track."""
    track = project.draw.choice(project.tracks())
    middle = [(a + b) / 2 for a, b in zip(numbers(sub(track, "start")), numbers(sub(track, "end")), strict=True)]
    hole = ["pad", '""', "np_thru_hole", "circle", ["at", "0", "0"], ["size", "0.8", "0.8"], ["drill", "0.8"],
            ["layers", '"*.Cu"', '"*.Mask"']]  # fmt: skip
    texts = [
        ["property", f'"{name}"', f'"{text}"', ["at", "0", "0"], ["layer", '"F.Fab"']]
        for name, text in (("Reference", "X1"), ("Value", "hole"))
    ]
    project.board.append(
        [
            "footprint",
            '"resgrid:X"',
            ["layer", '"F.Cu"'],
            ["at", *map(str, middle)],
            ["attr", "exclude_from_pos_files", "exclude_from_bom"],
            *texts,
            hole,
        ]
    )
    return [(project.net(track), "is split in")]


def leave_out_the_plating(project: Project) -> list[Place]:
    """Drill the hole of a test pad without plating."""
    pads = [
        (part, pad) for part in subs(project.board, "footprint") for pad in subs(part, "pad") if pad[2] == "thru_hole"
    ]
    part, pad = project.draw.choice(pads)
    pad[2] = "np_thru_hole"
    return [(reference(part),)]


def cut_the_plane(project: Project) -> list[Place]:
    """Cut the plane of the rail around a via that only the plane connects."""
    zones = [zone for zone in subs(project.board, "zone") if any(subs(zone, "filled_polygon"))]
    zone = max(zones, key=lambda zone: sum(len(sub(area, "pts")) for area in subs(zone, "filled_polygon")))
    areas = list(subs(zone, "filled_polygon"))
    copper = union_all([Polygon([numbers(xy) for xy in subs(sub(area, "pts"), "xy")]).buffer(0) for area in areas])
    via = project.only_via(project.net(zone))
    centre = Point(numbers(sub(via, "at")))
    rest = copper.difference(centre.buffer(1.0).difference(centre.buffer(0.7)))
    for area in areas:
        zone.remove(area)
    for piece in getattr(rest, "geoms", [rest]):
        points = [["xy", f"{x:.6f}", f"{y:.6f}"] for x, y in _keyholes(piece)]
        zone.append(["filled_polygon", sub(areas[0], "layer"), ["pts", *points]])
    return [(project.net(zone), "split in two")]


def _keyholes(polygon: Polygon) -> list[tuple[float, float]]:
    """The outline of a polygon, with a seam from each hole to the edge at its left, as KiCad writes filled areas."""
    points = np.array(polygon.exterior.coords)
    for hole in sorted(polygon.interiors, key=lambda ring: ring.bounds[0]):
        ring = np.array(hole.coords)[:-1]
        ring = np.roll(ring, -int(ring[:, 0].argmin()), axis=0)
        x, y = ring[0]
        start, end = points[:-1], points[1:]
        crossed = (start[:, 1] > y) != (end[:, 1] > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = start[:, 0] + (end[:, 0] - start[:, 0]) * (y - start[:, 1]) / (end[:, 1] - start[:, 1])
        edge = int(np.where(crossed & (at < x), at, -np.inf).argmax())
        seam = np.array([[at[edge], y]])
        points = np.concatenate([points[: edge + 1], seam, ring, ring[:1], seam, points[edge + 1 :]])
    return [(float(x), float(y)) for x, y in points[:-1]]


MUTATIONS: tuple[Callable[[Project], list[Place]], ...] = (
    swap_two_tracks,
    delete_a_track,
    shorten_a_track,
    delete_a_via,
    move_a_part,
    shift_a_part,
    turn_a_part,
    turn_a_part_around,
    omit_a_part,
    exchange_two_parts,
    change_a_value_on_the_board,
    change_a_value_in_the_schematic,
    omit_a_symbol,
    state_a_wrong_net,
    bridge_two_pads,
    drill_through_a_track,
    leave_out_the_plating,
    cut_the_plane,
)


def located(findings: tuple[str, ...], places: list[Place]) -> bool:
    """Whether for each place, a finding contains all of its words."""
    return all(any(all(_holds(finding, word) for word in place) for finding in findings) for place in places)


def _holds(text: str, word: str) -> bool:
    return (
        re.search(rf"(?<![\w]){re.escape(word)}(?![\w])", text) is not None
        if word.strip() == word and not word.endswith("(")
        else word in text
    )
