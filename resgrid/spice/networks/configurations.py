"""Configuration files of Circuitscape: keys, defaults and values as Circuitscape 5 reads them.

The rules and the defaults are those of ``parse_config`` and ``init_config`` in ``src/config.jl`` of Circuitscape.jl: a
line ``[...]`` is skipped, the first ``=`` ends the key, the last value of a repeated key counts, and keys are
case-sensitive.  Circuitscape ignores unknown keys and reads every value except ``True``, ``true`` and ``1`` as false.
Here unknown keys and other values are errors, because they are mostly mistakes.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from resgrid.errors import InputError
from resgrid.spice.networks.edges import Measure
from resgrid.spice.read.files import read_text

_DEFAULTS = {
    "scenario": "not entered",
    "data_type": "raster",
    "habitat_file": "(Browse for a resistance file)",
    "habitat_map_is_resistances": "True",
    "connect_four_neighbors_only": "False",
    "connect_using_avg_resistances": "False",
    "use_polygons": "False",
    "polygon_file": "(Browse for a short-circuit region file)",
    "source_file": "(Browse for a current source file)",
    "ground_file": "(Browse for a ground point file)",
    "ground_file_is_resistances": "True",
    "use_unit_currents": "False",
    "use_direct_grounds": "False",
    "remove_src_or_gnd": "keepall",
    "use_mask": "False",
    "mask_file": "None",
    "use_reclass_table": "False",
    "point_file": "(Browse for file with locations of focal points or regions)",
    "use_included_pairs": "False",
    "included_pairs_file": "(Browse for a file with pairs to include or exclude)",
    "use_variable_source_strengths": "False",
    "variable_source_file": "None",
    "output_file": "(Choose a base name for output files)",
    "write_cur_maps": "False",
    "write_volt_maps": "False",
    "write_cum_cur_map_only": "False",
    "write_max_cur_maps": "False",
    "set_null_currents_to_nodata": "False",
    "set_null_voltages_to_nodata": "False",
    "set_focal_node_currents_to_zero": "False",
    "compress_grids": "False",
    "log_transform_maps": "False",
    "write_as_tif": "False",
}
"""Default texts, in Circuitscape 5, of the keys that change the circuit or the output files, by key."""

_WITHOUT_EFFECT = frozenset(
    {
        "version", "reclass_file", "point_file_contains_polygons", "solver", "precision", "use_64bit_indexing",
        "cholmod_batch_size", "low_memory_mode", "preemptive_memory_release", "parallelize", "max_parallel",
        "print_timings", "print_rusages", "log_file", "log_level", "screenprint_log", "suppress_messages",
        "profiler_log_file",
    }
)  # fmt: skip
"""Keys of Circuitscape 3.5 to 5 that are ignored here; most of them choose solvers and messages."""

CONNECTIVITY = ("pairwise", "one-to-all", "all-to-one")
"""Scenarios of jobs that solve several circuits, each with sources and grounds at focal points."""

_FLAGS = dict.fromkeys(("True", "true", "1"), True) | dict.fromkeys(("False", "false", "0"), False)
_PLACEHOLDERS = ("", "None", "none")


@dataclass(frozen=True, eq=False)
class Configuration:
    """The keys and values of one Circuitscape configuration.

    `path`: name of the file for messages; `folder`: folder of the file, to which file names are relative; `root`:
    folder that must contain all files that the configuration names; `values`: texts of the values by key.
    """

    path: str
    folder: Path
    root: Path
    values: Mapping[str, str]

    def text(self, key: str) -> str:
        """Return the text of a key's value, or the default of Circuitscape if the file does not have the key."""
        return self.values.get(key, _DEFAULTS[key])

    def flag(self, key: str) -> bool:
        """Return the value of a boolean key; raise InputError for text other than True, true, 1, False, false and 0."""
        word = self.text(key)
        if word not in _FLAGS:
            raise InputError(
                f"{self.path}: {key} = {word!r} is neither True nor False (Circuitscape reads only True, true and 1 "
                "as true)"
            )
        return _FLAGS[word]

    def measure(self, key: str) -> Measure:
        """Return the quantity of the values in a raster or list, "resistance" or "conductance", from a boolean key.

        `key`: key that states whether the values are resistances, such as ``habitat_map_is_resistances``.
        """
        return "resistance" if self.flag(key) else "conductance"

    def file(self, key: str) -> Path:
        """Return the path of the file that a key names; raise InputError if the folder `root` contains no such file.

        If the named file is missing, a file with the same name in the configuration's folder is used.  A configuration
        without the key raises InputError, too.
        """
        name = self.text(key)
        if name in _PLACEHOLDERS or name == _DEFAULTS[key]:
            raise InputError(f"{self.path}: the key {key!r} is missing; name the file")
        for candidate in (self.folder / name, self.folder / Path(name.replace("\\", "/")).name):
            try:
                path = candidate.resolve()
                if path.is_relative_to(self.root) and path.is_file():
                    return path
            except (OSError, ValueError, RuntimeError):
                continue
        raise InputError(
            f"{self.path}: {key} = {name!r} is not a file below {str(self.root)!r}; correct the name, or name a folder "
            "that contains the file by --root FOLDER (in Python: root=)"
        )

    @property
    def scenario(self) -> str:
        """The scenario in lower case, with hyphens: ``advanced``, ``pairwise``, ``one-to-all`` or ``all-to-one``."""
        return self.text("scenario").lower().replace("_", "-")

    def base(self) -> str:
        """Return the path with which the names of output files begin: that of the key ``output_file`` without ``.out``.

        Raises InputError if the key is missing.
        """
        name = self.text("output_file")
        if name in _PLACEHOLDERS or name == _DEFAULTS["output_file"]:
            raise InputError(f"{self.path}: the key 'output_file' is missing; name the base of the output files")
        return name.split(".out")[0]


def is_connectivity_job(path: str | os.PathLike[str]) -> bool:
    """Return whether the scenario of a Circuitscape configuration is one of `CONNECTIVITY`, such as ``pairwise``."""
    return read_configuration(path).scenario in CONNECTIVITY


def read_configuration(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Configuration:
    """Return the keys and values of a configuration file; raise InputError for unknown keys and lines without ``=``.

    Empty lines and lines that begin with ``[``, ``#`` or ``;`` are skipped.

    `root`: folder that must contain the files named in the configuration, by default the folder of `path`.
    """
    name = os.fspath(path)
    values: dict[str, str] = {}
    for number, line in enumerate(read_text(path).split("\n"), 1):
        if not line.strip() or line[0] in "[#;":
            continue
        key, equals, value = line.partition("=")
        key = key.rstrip()
        if not equals:
            raise InputError(f"{name}:{number}: not a configuration: {line.strip()[:80]!r} is not 'key = value'")
        if key not in _DEFAULTS and key not in _WITHOUT_EFFECT:
            raise InputError(f"{name}:{number}: {_advice(key)}")
        values[key] = value.strip()
    folder = Path(name).resolve().parent
    return Configuration(name, folder, folder if root is None else Path(root).resolve(), values)


def _advice(key: str) -> str:
    """Return the error message about the unknown key `key`, with the most similar known key if there is one."""
    near = difflib.get_close_matches(key.strip().lower(), [*_DEFAULTS, *sorted(_WITHOUT_EFFECT)], 1)
    if near and near[0] == key.strip().lower():
        return f"Circuitscape does not read the key {key!r}; write it {near[0]!r}, without blanks before it"
    hint = f"; did you mean {near[0]!r}?" if near else "; remove the line"
    return f"Circuitscape has no key {key.strip()!r}{hint}"
