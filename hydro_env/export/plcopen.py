"""Structured Text as a project in PLCopen XML (TC6 XML 2.01, namespace tc6_0201), which engineering tools import.

The task has its interval as Codesys and TwinCAT write it (`PT0.01S`); Codesys reads it in its own `TaskSettings` first.
"""

import re
from datetime import UTC, datetime
from xml.etree import ElementTree as xml

from .templates import template

_SECTIONS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars"}
_UNIT = re.compile(
    r"(?:^\(\*(?P<about>[^*]*(?:\*(?!\))[^*]*)*)\*\)\n)?^(?P<kind>FUNCTION_BLOCK|PROGRAM) (?P<name>\w+)\n"
    r"(?P<sections>(?:VAR.*?\nEND_VAR\n)*)\n(?P<body>.*?)^END_(?P=kind)$",
    re.DOTALL | re.MULTILINE,
)
_SECTION = re.compile(r"^(VAR\w*)( CONSTANT)?\n(.*?)^END_VAR$", re.DOTALL | re.MULTILINE)
_VARIABLE = re.compile(
    r"^ {4}(?P<name>\w+)(?: AT (?P<at>%\S+))? : (?:ARRAY\[0\.\.(?P<last>\d+)\] OF )?(?P<type>\w+)"
    r"(?: := (?P<value>[^;]+))?;(?: \(\* (?P<about>.*) \*\))?$",
    re.MULTILINE,
)


def plcopen_xml(text: str, name: str, period: float, version: str) -> str:
    """The project of function blocks and the program, as `plc` writes them; a task runs the program every `period` s."""
    return template("plcopen.xml").substitute(
        units="\n".join(map(_unit, _UNIT.finditer(text))), name=name, version=version, period=f"{period:.7g}",
        microseconds=round(1e6 * period), now=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S"),
    )  # fmt: skip


def _add(parent: xml.Element, tag: str, **attributes: str | None) -> xml.Element:
    return xml.SubElement(parent, tag, {name: value for name, value in attributes.items() if value})


def _text(parent: xml.Element, tag: str, text: str) -> None:
    _add(_add(parent, tag), "xhtml", xmlns="http://www.w3.org/1999/xhtml").text = text


def _unit(unit: re.Match[str]) -> str:
    kind = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}[unit["kind"]]
    pou = xml.Element("pou", name=unit["name"], pouType=kind)
    interface = _add(pou, "interface")
    for section, constant, declared in _SECTION.findall(unit["sections"]):
        made = _add(interface, _SECTIONS.get(section, "localVars"), constant="true" if constant else None)
        for each in _VARIABLE.finditer(declared):
            _variable(made, each)
    _text(interface, "documentation", " ".join((unit["about"] or "").split()))
    _text(_add(pou, "body"), "ST", unit["body"])
    xml.indent(pou)
    return xml.tostring(pou, encoding="unicode")


def _variable(section: xml.Element, declared: re.Match[str]) -> None:
    variable = _add(section, "variable", name=declared["name"], address=declared["at"])
    base, many = _add(variable, "type"), declared["last"]
    if many:
        array = _add(base, "array")
        _add(array, "dimension", lower="0", upper=many)
        base = _add(array, "baseType")
    elementary = declared["type"].isupper()
    _add(base, declared["type"] if elementary else "derived", name=None if elementary else declared["type"])
    if declared["value"]:
        initial = _add(variable, "initialValue")
        array = _add(initial, "arrayValue") if many else initial
        for number in re.findall(r"[^\[\],\s]+", declared["value"]):
            _add(_add(array, "value") if many else array, "simpleValue", value=number)
    if declared["about"]:
        _text(variable, "documentation", declared["about"])
