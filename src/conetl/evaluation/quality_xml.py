"""The quality report as a `DQ_DataQuality` of ISO/TS 19157-2:2016, the XML that goes with metadata of ISO 19115-3."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lxml import etree
from lxml.builder import ElementMaker

from conetl.evaluation.map_quality import MapQuality, Measure
from conetl.files.atomic import atomic_files

_NAMESPACES = {
    "mdq": "http://standards.iso.org/iso/19157/-2/mdq/1.0",
    "mcc": "http://standards.iso.org/iso/19115/-3/mcc/1.0",
    "gco": "http://standards.iso.org/iso/19115/-3/gco/1.0",
    "xlink": "http://www.w3.org/1999/xlink",
}
_MDQ, _MCC, _GCO = (ElementMaker(namespace=_NAMESPACES[name], nsmap=_NAMESPACES) for name in list(_NAMESPACES)[:3])
_HREF = f"{{{_NAMESPACES['xlink']}}}href"
#: How the name of a measure begins -> its element; others are of the conceptual schema.
_ELEMENTS = {
    "omission": "DQ_CompletenessOmission",
    "commission": "DQ_CompletenessCommission",
    "absolute": "DQ_AbsoluteExternalPositionalAccuracy",
    "classification": "DQ_ThematicClassificationCorrectness",
    "temporal validity": "DQ_TemporalValidity",
    "temporal consistency": "DQ_TemporalConsistency",
}
#: Units of the measures that are no counts, in UCUM.
_UNITS = {"m": "http://www.opengis.net/def/uom/UCUM/0/m", "ratio": "http://www.opengis.net/def/uom/UCUM/0/1"}
_CODES = "http://standards.iso.org/iso/{}/resources/Codelists/cat/codelists.xml#{}"
#: An element of lxml, which has no types.
Element = Any


def write_quality_xml(path: Path, quality: MapQuality) -> Path:
    """Write all measures with their values to the last digit. Raises InputError where the file cannot be written."""
    state = f"Map {quality.map_name}, EPSG:{quality.srid}, {quality.features} objects"
    level = _MCC.MD_ScopeCode("dataset", codeList=_CODES.format("19115", "MD_ScopeCode"), codeListValue="dataset")
    described = _MCC.levelDescription(_MCC.MD_ScopeDescription(_MCC.dataset(_text(state))))
    root = _MDQ.DQ_DataQuality(
        _MDQ.scope(_MCC.MD_Scope(_MCC.level(level), described)),
        *(_MDQ.report(_report(measure, quality)) for measure in quality.measures),
    )
    with atomic_files(path) as (file,):
        etree.ElementTree(root).write(file, encoding="UTF-8", xml_declaration=True, pretty_print=True)
    return path


def _report(measure: Measure, quality: MapQuality) -> Element:
    name = _ELEMENTS.get(measure.name.partition(":")[0], "DQ_ConceptualConsistency")
    of_points = "check points" in measure.basis
    results = [_MDQ.result(_result(measure, quality))]
    if of_points and measure.unit == "m" and quality.positional is not None:
        results.append(_MDQ.result(_statement(quality.positional.statement, quality)))
    kind = "directExternal" if of_points else "directInternal"
    code = _MDQ.DQ_EvaluationMethodTypeCode(
        kind, codeList=_CODES.format("19157", "DQ_EvaluationMethodTypeCode"), codeListValue=kind
    )
    method = _MDQ.DQ_EvaluationMethod(
        _MDQ.evaluationMethodDescription(_text(measure.basis)), _MDQ.evaluationMethodType(code)
    )
    reference = _MDQ.DQ_MeasureReference(
        _MDQ.nameOfMeasure(_text(measure.name)), _MDQ.measureDescription(_text(measure.element))
    )
    return _MDQ(name, _MDQ.measure(reference), _MDQ.evaluationMethod(method), *results)


def _result(measure: Measure, quality: MapQuality) -> Element:
    """The value, or that there is none."""
    if measure.value is None:
        return _statement(measure.basis, quality)
    unit = _UNITS.get(measure.unit)
    return _MDQ.DQ_QuantitativeResult(
        _time(quality),
        _MDQ.value(_GCO.Record(_GCO.Real(repr(measure.value)))),
        *([] if unit is None else [_MDQ.valueUnit({_HREF: unit})]),
        _MDQ.valueRecordType(_GCO.RecordType(f"Real, {measure.unit}")),
    )


def _statement(text: str, quality: MapQuality) -> Element:
    return _MDQ.DQ_DescriptiveResult(_time(quality), _MDQ.statement(_text(text)))


def _time(quality: MapQuality) -> Element:
    return _MDQ.dateTime(_GCO.DateTime(quality.at.isoformat()))


def _text(text: str) -> Element:
    return _GCO.CharacterString(text)
