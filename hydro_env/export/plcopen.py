"""Structured Text as a project in PLCopen XML (TC6 XML 2.01, namespace tc6_0201), which engineering tools import."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from xml.etree import ElementTree as xml

__all__ = ["plcopen_xml"]

NAMESPACE = "http://www.plcopen.org/xml/tc6_0201"
XHTML = "http://www.w3.org/1999/xhtml"
#: Codesys and what is made of it read the cycle of a task here.
TASK_SETTINGS = "http://www.3s-software.com/plcopenxml/tasksettings"
_SECTIONS = {
    "VAR_INPUT": "inputVars",
    "VAR_OUTPUT": "outputVars",
    "VAR": "localVars",
    "VAR CONSTANT": "localVars",
}
_UNIT = re.compile(
    r"(?:^\(\*(?P<about>[^*]*(?:\*(?!\))[^*]*)*)\*\)\n)?^(?P<kind>FUNCTION_BLOCK|PROGRAM) (?P<name>\w+)\n"
    r"(?P<sections>(?:VAR.*?\nEND_VAR\n)*)\n(?P<body>.*?)^END_(?P=kind)$",
    re.DOTALL | re.MULTILINE,
)
_SECTION = re.compile(r"^(VAR\w*(?: CONSTANT)?)\n(.*?)^END_VAR$", re.DOTALL | re.MULTILINE)
_VARIABLE = re.compile(
    r"^ {4}(?P<name>\w+)(?: AT (?P<at>%\S+))? : (?:ARRAY\[(?P<low>\d+)\.\.(?P<high>\d+)\] OF )?(?P<type>\w+)"
    r"(?: := (?P<value>[^;]+))?;(?: \(\* (?P<about>.*) \*\))?$",
    re.MULTILINE,
)
_ELEMENTARY = ("BOOL", "INT", "DINT", "REAL", "LREAL")


def plcopen_xml(text: str, name: str, period: float, version: str) -> str:
    """The project of function blocks and one program, as this package writes them; a task runs the program every `period` s."""
    root = xml.Element("project", xmlns=NAMESPACE)
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    _add(
        root,
        "fileHeader",
        companyName="hydro_env",
        productName="hydro_env",
        productVersion=version,
        creationDateTime=now,
    )
    coordinates = _add(_add(root, "contentHeader", name=name), "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        _add(_add(coordinates, language), "scaling", x="1", y="1")
    types = _add(root, "types")
    _add(types, "dataTypes")
    pous, program = _add(types, "pous"), ""
    for unit in _UNIT.finditer(text):
        kind = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}[unit["kind"]]
        program = unit["name"] if kind == "program" else program
        _pou(_add(pous, "pou", name=unit["name"], pouType=kind), unit)
    instances = _add(_add(root, "instances"), "configurations")
    resource = _add(_add(instances, "configuration", name="Plc"), "resource", name="Application")
    task = _add(resource, "task", name="Cycle", interval=f"PT{period:.7g}S", priority="1")
    _add(task, "pouInstance", name=program, typeName=program)
    data = _add(_add(task, "addData"), "data", name=TASK_SETTINGS, handleUnknown="discard")
    interval = f"t#{round(1e6 * period)}us"
    _add(data, "TaskSettings", KindOfTask="Cyclic", Interval=interval, IntervalUnit="us", xmlns="")
    xml.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + xml.tostring(root, encoding="unicode") + "\n"


def _add(parent: xml.Element, tag: str, **attributes: str) -> xml.Element:
    return xml.SubElement(parent, tag, attributes)


def _text(parent: xml.Element, tag: str, text: str) -> None:
    _add(_add(parent, tag), "xhtml", xmlns=XHTML).text = text


def _pou(pou: xml.Element, unit: re.Match[str]) -> None:
    interface = _add(pou, "interface")
    for kind, declared in _SECTION.findall(unit["sections"]):
        section = _add(interface, _SECTIONS[kind], **({"constant": "true"} if "CONSTANT" in kind else {}))
        for each in _VARIABLE.finditer(declared):
            _variable(section, each)
    _text(interface, "documentation", " ".join((unit["about"] or "").split()))
    _text(_add(pou, "body"), "ST", unit["body"])


def _variable(section: xml.Element, declared: re.Match[str]) -> None:
    variable = _add(
        section, "variable", name=declared["name"], **({"address": declared["at"]} if declared["at"] else {})
    )
    base = _add(variable, "type")
    if declared["high"]:
        array = _add(base, "array")
        _add(array, "dimension", lower=declared["low"], upper=declared["high"])
        base = _add(array, "baseType")
    elementary = declared["type"] in _ELEMENTARY
    _add(base, declared["type"]) if elementary else _add(base, "derived", name=declared["type"])
    if declared["value"]:
        initial = _add(variable, "initialValue")
        numbers = re.findall(r"[^\[\],\s]+", declared["value"])
        if declared["high"]:
            array = _add(initial, "arrayValue")
            for each in numbers:
                _add(_add(array, "value"), "simpleValue", value=each)
        else:
            _add(initial, "simpleValue", value=numbers[0])
    if declared["about"]:
        _text(variable, "documentation", declared["about"])
