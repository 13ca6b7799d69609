"""Writes a digital calibration certificate (DCC, PTB's schema 3.1.2).

An uncertainty is written expanded by a factor of 2, with the probability that this covers: doubling and
halving lose no digit of a number, so that whoever reads it has the standard uncertainty to the last one.
"""

import datetime
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final
from xml.etree import ElementTree

from calibration.certificate import DCC, SI
from processing.d_si import in_d_si

SCHEMA: Final = "3.1.2"
COVERAGE_FACTOR: Final = 2.0
_INSTANCE: Final = "http://www.w3.org/2001/XMLSchema-instance"
_UNKNOWN_COUNTRY: Final = "ZZ"
_NOT_OF_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_NOT_STATED: Final = "not stated"

Element = ElementTree.Element


@dataclass(frozen=True, slots=True)
class ResultNumber:
    """A number to be certified: its key, what it is, value, unit and standard uncertainty (NaN: none).

    `dof` are the degrees of freedom of the uncertainty.
    """

    key: str
    name: str
    value: float
    unit: str
    u: float = math.nan
    dof: float = math.inf


@dataclass(frozen=True, slots=True)
class ResultGroup:
    """Numbers that were found in one way; `left_out` are the names of those that were not determined."""

    name: str
    numbers: Sequence[ResultNumber]
    left_out: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class CertifiedMeasurement:
    """One measurement: its method, and the results, with the files they were made from by their hashes."""

    name: str
    method: str
    groups: Sequence[ResultGroup]
    sources: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class CertificateFacts:
    """What a certificate says beside its results."""

    identifier: str
    software: str
    release: str
    item: str
    item_identifier: str
    made_by: str
    began: datetime.date
    ended: datetime.date
    valid_until: datetime.date | None = None
    simulated: bool = False


def certificate_bytes(facts: CertificateFacts, measurements: Sequence[CertifiedMeasurement]) -> bytes:
    """The certificate as XML."""
    for prefix, name in (("dcc", DCC), ("si", SI), ("xsi", _INSTANCE)):
        ElementTree.register_namespace(prefix, name)
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", schemaVersion=SCHEMA)
    root.set(f"{{{_INSTANCE}}}schemaLocation", f"{DCC} {DCC}/v{SCHEMA}/dcc.xsd")
    _administration(_dcc(root, "administrativeData"), facts)
    results = _dcc(root, "measurementResults")
    for one in measurements:
        _measurement(_dcc(results, "measurementResult"), one)
    ElementTree.indent(root)
    written: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return written + b"\n"


def _administration(above: Element, facts: CertificateFacts) -> None:
    software = _dcc(_dcc(above, "dccSoftware"), "software")
    _named(software, facts.software)
    _dcc(software, "release", facts.release or "unknown")
    core = _dcc(above, "coreData")
    _dcc(core, "countryCodeISO3166_1", _UNKNOWN_COUNTRY)
    _dcc(core, "usedLangCodeISO639_1", "en")
    _dcc(core, "mandatoryLangCodeISO639_1", "en")
    _dcc(core, "uniqueIdentifier", facts.identifier)
    _dcc(core, "beginPerformanceDate", facts.began.isoformat())
    _dcc(core, "endPerformanceDate", facts.ended.isoformat())
    _dcc(core, "performanceLocation", "other")
    item = _dcc(_dcc(above, "items"), "item")
    _named(item, facts.item)
    _named(_dcc(item, "manufacturer"), _NOT_STATED)
    identification = _dcc(_dcc(item, "identifications"), "identification")
    _dcc(identification, "issuer", "other")
    _dcc(identification, "value", facts.item_identifier)
    _contact(_dcc(_dcc(above, "calibrationLaboratory"), "contact"))
    person = _dcc(_dcc(above, "respPersons"), "respPerson")
    _named(_dcc(person, "person"), facts.made_by or _NOT_STATED)
    _dcc(person, "mainSigner", "true")
    _contact(_dcc(above, "customer"))
    statements = _dcc(above, "statements")
    said = "Written by the program that measured; not signed, and not issued by an accredited laboratory."
    if facts.simulated:
        said = f"SIMULATED: no measurement of anything. {said}"
    _said(_dcc(_dcc(statements, "statement"), "declaration"), said)
    if facts.valid_until is not None:
        statement = _dcc(statements, "statement")
        statement.set("refType", "basic_recalibration")
        _said(_dcc(statement, "declaration"), "To be calibrated again by this date.")
        _dcc(statement, "date", facts.valid_until.isoformat())


def _measurement(above: Element, one: CertifiedMeasurement) -> None:
    _named(above, one.name)
    if said := [*one.notes, *(f"made from {name}, SHA-256 {sha256}" for name, sha256 in one.sources.items())]:
        _said(_dcc(above, "description"), *said)
    method = _dcc(_dcc(above, "usedMethods"), "usedMethod")
    _named(method, one.method or _NOT_STATED)
    _dcc(method, "norm", "JCGM 100:2008")
    results = _dcc(above, "results")
    for group in one.groups:
        result = _dcc(results, "result")
        _named(result, group.name)
        data = _dcc(result, "data")
        if group.left_out:
            _said(_dcc(data, "text"), f"Not determined, and hence not stated: {', '.join(group.left_out)}.")
        for number in group.numbers:
            _quantity(_dcc(data, "quantity"), number)


def _quantity(above: Element, number: ResultNumber) -> None:
    above.set("refType", f"rig_{number.key}")
    _named(above, number.name)
    real = _si(above, "real")
    _si(real, "value", repr(float(number.value)))
    _si(real, "unit", in_d_si(number.unit))
    if math.isnan(number.u):
        return
    expanded = _si(real, "expandedUnc")
    _si(expanded, "uncertainty", repr(COVERAGE_FACTOR * number.u))
    _si(expanded, "coverageFactor", repr(COVERAGE_FACTOR))
    _si(expanded, "coverageProbability", f"{coverage_probability(number.dof):.6f}")
    _si(expanded, "distribution", "normal" if math.isinf(number.dof) else f"t, {number.dof:.4g} dof")


def coverage_probability(dof: float, k: float = COVERAGE_FACTOR) -> float:
    """What `k` standard uncertainties cover: of a normal distribution, or of Student's t."""
    if not math.isfinite(dof):
        return math.erf(k / math.sqrt(2.0))
    from scipy.special import stdtr

    return 2.0 * float(stdtr(dof, k)) - 1.0


def _contact(above: Element) -> None:
    """Who this is, the program does not know: the parts that the schema requires."""
    _named(above, _NOT_STATED)
    _dcc(above, "eMail", "")
    _said(_dcc(_dcc(above, "location"), "further"), _NOT_STATED)


def _named(above: Element, text: str) -> None:
    _said(_dcc(above, "name"), text)


def _said(above: Element, *texts: str) -> None:
    for text in texts:
        _dcc(above, "content", text).set("lang", "en")


def _dcc(above: Element, name: str, text: str | None = None) -> Element:
    return _below(above, f"{{{DCC}}}{name}", text)


def _si(above: Element, name: str, text: str | None = None) -> Element:
    return _below(above, f"{{{SI}}}{name}", text)


def _below(above: Element, tag: str, text: str | None) -> Element:
    found = ElementTree.SubElement(above, tag)
    # what XML has no way to write is no text of a certificate
    found.text = text if text is None else _NOT_OF_XML.sub("", text)
    return found
