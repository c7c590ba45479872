"""Script for a Python interpreter with klayout: extract the circuit of a layout, and check its design rules.

Run as ``python klayout_extraction.py LAYOUT JOB``: JOB is a JSON file with layers, connections and rules (see `main`),
and standard output gets the result as JSON.  This file imports nothing of resgrid, and resgrid never runs it in its own
process, because KLayout is licensed under the GPL.
"""

from __future__ import annotations

import importlib
import json
import sys
from typing import Any

PLACES = 20
"""Largest number of places that are reported for each violated rule."""


def main(file: str, job_file: str) -> None:
    """Extract the circuit of a layout, check its design rules, and print the result as JSON.

    `file`: the layout; `job_file`: JSON file of an object with the keys ``layers`` (GDSII numbers by name), ``body``
    and ``ends`` (names of layers), ``conductors`` (names), ``connections`` (pairs of names), ``texts`` (name of a metal
    and GDSII numbers of its labels), ``outline`` (GDSII numbers) and ``rules`` (objects; empty for no check). The
    printed object has the keys ``dbu`` (database unit in micrometres), ``top`` (name of the top cell), ``texts``
    (labels of the outline), ``resistors``, ``labels``, ``messages`` and ``violations``.
    """
    kdb = importlib.import_module("klayout.db")
    with open(job_file, encoding="utf-8") as stream:  # noqa: PTH123 - the script needs no other import
        job = json.load(stream)
    layout = kdb.Layout()
    try:
        layout.read(file)
    except RuntimeError as error:
        raise SystemExit(f"{error}; write the layout again") from None
    tops = layout.top_cells()
    if len(tops) != 1:
        raise SystemExit(f"{len(tops)} top cells instead of one")
    result = {"dbu": layout.dbu, "top": tops[0].name, "texts": texts(kdb, layout, tops[0], job)}
    result |= circuit(kdb, layout, tops[0], job)
    result["violations"] = violations(kdb, layout, tops[0], job) if job["rules"] else []
    json.dump(result, sys.stdout)


def texts(kdb: Any, layout: Any, top: Any, job: Any) -> list[list[Any]]:
    """Return text, x and y, in database units, of every label on the layer of the layout's outline.

    `kdb`: module klayout.db; `layout`: the read layout; `top`: its top cell; `job`: layers, connections and rules.
    """
    found = kdb.Texts(top.begin_shapes_rec(layout.layer(*job["outline"])))
    return sorted([text.string, text.x, text.y] for text in found.each())


def circuit(kdb: Any, layout: Any, top: Any, job: Any) -> dict[str, Any]:
    """Return the extracted circuit as a dictionary of lists.

    Keys: ``resistors``, each as x and y of the lower left corner of its body, area, width, number of corners and the
    numbers of both nets; ``labels``, each as text, name of the metal, x and y, and number of the net (None where the
    label lies on no metal); ``messages``, about faulty resistors. Lengths are in database units. `kdb`: module
    klayout.db; `layout`: the read layout; `top`: its top cell; `job`: layers, connections and rules.
    """
    extraction = kdb.LayoutToNetlist(kdb.RecursiveShapeIterator(layout, top, []))
    at = {name: extraction.make_layer(layout.layer(*layer), name) for name, layer in job["layers"].items()}
    body, ends = body_and_ends(at, job)
    at["ends"] = ends
    extractor = resistor_extractor(kdb)
    extraction.extract_devices(extractor, {"body": body, "ends": ends, "terminal": ends})
    for name in job["conductors"]:
        extraction.connect(at[name])
    for lower, upper in job["connections"]:
        extraction.connect(at[lower], at[upper])
    extraction.extract_netlist()
    netlist = extraction.netlist()
    netlist.flatten()
    found = netlist.circuit_by_name(top.name)
    devices = list(found.each_device()) if found else []
    probes = []
    for metal, layer in job["texts"]:
        labels = kdb.Texts(top.begin_shapes_rec(layout.layer(*layer)))
        for text in labels.each():
            net = extraction.probe_net(at[metal], kdb.Point(text.x, text.y))
            probes.append([text.string, metal, text.x, text.y, None if net is None else net.cluster_id])
    return {
        "resistors": sorted(resistor(extraction, device) for device in devices),
        "labels": sorted(probes, key=lambda probe: probe[:4]),
        "messages": [entry.message for entry in extractor.each_log_entry()],
    }


def body_and_ends(regions: Any, job: Any) -> tuple[Any, Any]:
    """Return the regions of the bodies and of the ends of resistors.

    A body lies where all layers of bodies overlap; an end where all layers of ends overlap, outside bodies. `regions`:
    region of each layer by name; `job`: names of the layers of bodies and ends.
    """
    body, ends = regions[job["body"][0]], regions[job["ends"][0]]
    for name in job["body"][1:]:
        body = body & regions[name]
    for name in job["ends"][1:]:
        ends = ends & regions[name]
    return body, ends - body


def resistor(extraction: Any, device: Any) -> list[Any]:
    """Return x, y, area, width, number of corners, and numbers of both nets of an extracted resistor.

    (x, y) is the lower left corner of the body. The net of the left end comes first; a net is None without a
    connection. Lengths are in database units, areas in their squares. `extraction`: the extraction to which the
    extracted resistor `device` belongs.
    """
    unit = extraction.internal_layout().dbu
    place = device.trans.disp
    nets = [device.net_for_terminal(number) for number in range(2)]
    values = [round(device.parameter(name)) for name in ("A", "W", "P")]
    return [
        round(place.x / unit),
        round(place.y / unit),
        *values,
        *(net.cluster_id if net else None for net in nets),
    ]


def resistor_extractor(kdb: Any) -> Any:
    """Return an extractor of resistors whose bodies have a constant width and right-angled corners.

    The parameters of a device are area A, width W and number of corners P, in database units.
    """

    class SerpentineExtractor(kdb.GenericDeviceExtractor):  # type: ignore[misc]
        """Extractor of resistors with a body between two ends, which klayout calls for each cell of the layout."""

        def setup(self) -> None:
            self.name = "resistor"
            for layer in ("body", "ends", "terminal"):
                self.define_layer(layer, layer)
            device = kdb.DeviceClassResistor()
            device.name = "resistor"
            device.supports_parallel_combination = False
            device.supports_serial_combination = False
            self.register_device_class(device)

        def get_connectivity(self, _layout: Any, layers: Any) -> Any:
            connectivity = kdb.Connectivity()
            connectivity.connect(layers[0], layers[0])
            connectivity.connect(layers[0], layers[1])
            return connectivity

        def extract_devices(self, geometry: Any) -> None:
            bodies, ends = geometry[0].merged(), geometry[1].merged()
            for polygon in bodies.each():
                body = kdb.Region(polygon)
                touching = sorted(ends.interacting(body).each(), key=lambda end: (end.bbox().left, end.bbox().bottom))
                contact = [edge.length() for edge in (body.edges() & ends.edges()).each()]
                if len(touching) != 2 or len(contact) != 2:
                    self.error(f"a resistor has {len(touching)} ends at {polygon.bbox()}", polygon)
                    continue
                device = self.create_device()
                device.trans = kdb.DCplxTrans(1, 0, False, kdb.DVector(polygon.bbox().p1 - kdb.Point()) * self.dbu())
                device.set_parameter("A", polygon.area())
                device.set_parameter("W", min(contact))
                device.set_parameter("P", (polygon.num_points() - 4) // 2)
                for number, end in enumerate(touching):
                    self.define_terminal(device, number, 2, end)

    return SerpentineExtractor()


def violations(kdb: Any, layout: Any, top: Any, job: Any) -> list[list[Any]]:
    """Return name, number of places, and the first `PLACES` places [x, y] of every violated design rule.

    `kdb`: module klayout.db; `layout`: the read layout; `top`: its top cell; `job`: layers, connections and rules.
    Places are in database units.
    """
    regions = {
        name: kdb.Region(top.begin_shapes_rec(layout.layer(*layer))).merged() for name, layer in job["layers"].items()
    }
    body, ends = body_and_ends(regions, job)
    regions |= {"body": body.merged(), "end": ends.merged(), "resistor": (body + ends).merged()}
    found = []
    for rule in job["rules"]:
        places = broken(kdb, regions, rule)
        if places:
            found.append([rule["name"], len(places), sorted(places)[:PLACES]])
    return found


def broken(kdb: Any, regions: Any, rule: Any) -> list[list[int]]:  # noqa: PLR0911 - one result per kind
    """Return the centres [x, y], in database units, of all places that violate a rule.

    `regions`: region of each layer by name; `rule`: object with ``kind``, ``layer``, ``other`` (second layer, None for
    some kinds) and ``value``, in database units or, for the kind "area", their squares. The value is the smallest
    "width", "space" between shapes, "separation" from the other layer, "enclosure" by the other layer on all sides,
    "margin" (enclosure measured only between edges that face each other) or "area"; the edge length of squares
    ("size"); or the spacing of the manufacturing "grid".
    """
    region, value = regions[rule["layer"]], rule["value"]
    other = regions.get(rule.get("other"))
    match rule["kind"]:
        case "width":
            return centres(region.width_check(value))
        case "space":
            return centres(region.space_check(value))
        case "size":
            return [
                centre(shape.bbox())
                for shape in region.each()
                if not (shape.is_box() and shape.bbox().width() == shape.bbox().height() == value)
            ]
        case "separation":
            return centres(region.separation_check(other, value)) + [centre(s.bbox()) for s in (region & other).each()]
        case "enclosure":
            return centres(region.enclosed_check(other, value)) + [centre(s.bbox()) for s in (region - other).each()]
        case "margin":
            return centres(region.enclosed_check(other, value, False, kdb.Region.Projection))
        case "area":
            return [centre(shape.bbox()) for shape in region.each() if shape.area() < value]
        case "grid":
            return centres(region.grid_check(value, value))
    raise SystemExit(f"unknown kind of rule {rule['kind']}")


def centres(pairs: Any) -> list[list[int]]:
    """Return the centres [x, y] of the bounding boxes of pairs of edges, in database units."""
    return [centre(pair.bbox()) for pair in pairs.each()]


def centre(box: Any) -> list[int]:
    """Return the centre [x, y] of a box, in database units."""
    return [box.center().x, box.center().y]


if __name__ == "__main__":
    main(*sys.argv[1:3])
