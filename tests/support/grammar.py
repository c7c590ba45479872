"""Grammar of Xyce and Spectre decks: one pattern per statement, with the chapter of the manual.

Xyce Reference Guide, chapter "Netlist Reference": "Netlist Commands" (.PARAM, .SUBCKT, .INCLUDE, .DC, .TRAN, .NOISE,
.STEP, .SAMPLING, .OPTIONS, .PRINT, .MEASURE) and "Devices" (resistor, capacitor, independent voltage and current
sources, nonlinear dependent source (B), subcircuit (X)).
Spectre Circuit Simulator Reference: "Component Statements" (resistor, capacitor, vsource, isource, bsource), "Analysis
Statements" (dc, tran, noise, sweep, montecarlo, options), and "Spectre Circuit Simulator User Guide", chapter "Spectre
Netlists" (title, simulator lang, include, global, parameters, subckt, statistics, save).
"""

from __future__ import annotations

import re

NUMBER = r"-?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?"
REST = r"[a-z0-9_]*"
NAME = rf"[a-z]{REST}"
NODE = rf"(?:0|{NAME})"
FORMULA = r"[-+*/(),.a-z0-9_]+"
VALUE = rf"(?:{NUMBER}|\{{{FORMULA}\}})"
FILE = r'"[^"]+"'
TC = rf"(?: tc1={NUMBER} tc2={NUMBER})?"
CROSSING = rf"when v\({NODE}\)={NUMBER} cross=1"
POINTS = rf"{NUMBER}(?: {NUMBER})*"

XYCE = {
    "comment": r"\* .*",
    "resistor": rf"r{REST} {NODE} {NODE} {VALUE}{TC}",
    "capacitor": rf"c{REST} {NODE} {NODE} {VALUE}(?: ic={NUMBER})?",
    "source": rf"[vi]{REST} {NODE} {NODE} {VALUE}(?: pwl\({POINTS}\))?(?: ac 1)?",
    "B source": rf"b{REST} {NODE} {NODE} i=\{{{FORMULA}\}}",
    "subcircuit": rf"x{REST}(?: {NODE})+ {NAME} params:(?: {NAME}={VALUE})+",
    ".SUBCKT": rf"\.subckt {NAME}(?: {NAME})+ params:(?: {NAME}={NUMBER})+",
    ".ENDS": rf"\.ends {NAME}",
    ".PARAM": rf"\.param {NAME}={NUMBER}",
    ".INCLUDE": rf"\.include {FILE}",
    ".OPTIONS": rf"\.options (?:(?:nonlin|timeint) reltol={NUMBER} abstol={NUMBER}|samples numsamples=\d+ seed=\d+)",
    ".DC": rf"\.dc {NAME} {NUMBER} {NUMBER} {NUMBER}",
    ".TRAN": rf"\.tran {NUMBER} {NUMBER} {NUMBER} {NUMBER}(?: uic)?",
    ".NOISE": rf"\.noise v\({NODE}\) {NAME} dec \d+ {NUMBER} {NUMBER}",
    ".STEP": rf"\.step temp list(?: {NUMBER})+",
    ".SAMPLING": r"\.sampling useexpr=true",
    ".PRINT": rf"\.print (?:dc|tran|noise) format=csv(?: precision=16)?(?: v\(\*\)| [vi]\({NAME}\)| [io]noise)+",
    ".MEASURE": rf"\.measure tran {NAME} (?:(?:max|min) v\({NODE}\)|find v\({NODE}\) at={NUMBER}|{CROSSING})",
    ".END": r"\.end",
}
SPECTRE_VALUE = rf"(?:{FORMULA}|{NUMBER})"
SPECTRE_TC = rf"(?: tc1={SPECTRE_VALUE} tc2={SPECTRE_VALUE})?"
SPECTRE_WAVE = rf"(?: type=pwl wave=\[{POINTS}\])?(?: mag=1)?"
SPECTRE = {
    "comment": r"// .*",
    "language": r"simulator lang=(?:spectre|spice)",
    "global": r"global 0",
    "include": rf"include {FILE}",
    "parameters": rf"parameters(?: {NAME}={NUMBER})+",
    "resistor": rf"{NAME} \({NODE} {NODE}\) (?:spread_)?resistor r={SPECTRE_VALUE}{SPECTRE_TC}",
    "capacitor": rf"{NAME} \({NODE} {NODE}\) capacitor c={SPECTRE_VALUE}(?: ic={NUMBER})?",
    "vsource, isource": rf"{NAME} \({NODE} {NODE}\) [vi]source dc={SPECTRE_VALUE}{SPECTRE_WAVE}",
    "bsource": rf"{NAME} \({NODE} {NODE}\) bsource i={FORMULA}",
    "subckt": rf"subckt {NAME} \({NAME}(?: {NAME})*\)",
    "ends": r"ends",
    "instance": rf"{NAME} \({NODE}(?: {NODE})+\) {NAME}(?: {NAME}={SPECTRE_VALUE})+",
    "statistics": r"statistics \{|  mismatch \{|    vary spread dist=gauss std=" + NUMBER + r"|  \}|\}",
    "dc": rf"(?:  )?{NAME} dc oppoint=rawfile",
    "tran": rf"{NAME} tran stop={NUMBER} maxstep={NUMBER}(?: skipdc=yes)?",
    "noise": rf"{NAME} \({NODE} 0\) noise start={NUMBER} stop={NUMBER} dec=\d+ iprobe={NAME}",
    "sweep": rf"{NAME} sweep param=temp values=\[{POINTS}\] \{{",
    "montecarlo": rf"{NAME} montecarlo numruns=\d+ seed=\d+ variations=mismatch savefamilyplots=yes \{{",
    "options": rf"{NAME} options reltol={NUMBER} vabstol={NUMBER} iabstol={NUMBER}",
    "save": rf"save(?: {NAME}(?::p)?)+",
    "measure (in lang=spice)": XYCE[".MEASURE"],
}
GRAMMARS = {"xyce": XYCE, "spectre": SPECTRE}


def strangers(text: str, dialect: str) -> list[str]:
    """Return the lines that match no statement of the dialect."""
    pattern = re.compile("|".join(f"(?:{rule})" for rule in GRAMMARS[dialect].values()))
    return [line for line in text.splitlines() if not pattern.fullmatch(line)]
