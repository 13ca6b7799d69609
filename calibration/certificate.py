"""Reads a digital calibration certificate (DCC, PTB's schema 3.x): its numbers with their uncertainties.

The format is XML of two parts: `dcc` says who has calibrated what, `si` (D-SI) how a number is written.
"""

import datetime
import math
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final
from xml.etree import ElementTree

from processing.d_si import from_d_si
from processing.errors import ConfigurationError
from processing.plain_xml import parsed_xml

Element = ElementTree.Element
DCC: Final = "https://ptb.de/dcc"
SI: Final = "https://ptb.de/si"
_NAMES: Final = {"dcc": DCC, "si": SI}
_STANDARD: Final = (
    ("coverageInterval", "standardUnc"),
    ("coverageIntervalMU", "standardMU"),
    ("standardMU", "valueStandardMU"),
)
"""Where a standard uncertainty stands, in D-SI 1 and 2."""
_ROOT: Final = "digitalCalibrationCertificate"
_LARGEST = 64 << 20


@dataclass(frozen=True, slots=True)
class CertifiedQuantity:
    """A number of a certificate.

    `unit` is spelled as in this project; empty, with `problem`, where it is none that is known here. `u` is
    the standard uncertainty, NaN where none is stated: an expanded one over its coverage factor `k`, which
    covers `probability`. `kinds` are the reference types by which certificates say what a number is.
    """

    name: str
    value: float
    unit: str
    u: float = math.nan
    k: float = math.nan
    probability: float = math.nan
    kinds: tuple[str, ...] = ()
    problem: str = ""


@dataclass(frozen=True, slots=True)
class Certificate:
    """What a certificate says; `recalibrate_by` is None where it states no such date."""

    schema: str
    identifier: str
    laboratory: str
    performed: datetime.date
    recalibrate_by: datetime.date | None
    item: str
    quantities: tuple[CertifiedQuantity, ...]


def is_certificate(data: bytes) -> bool:
    """Whether it looks like XML, which no other file of a calibration is."""
    return data.lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n")[:1] == b"<"


def parse_certificate(data: bytes, name: str) -> Certificate:
    """Read the content of a certificate; `name` is used in messages.

    Raises ConfigurationError for what is no certificate of schema 3.
    """
    if len(data) > _LARGEST:
        raise ConfigurationError(f"{name}: has {len(data) >> 20} MB, a certificate at most {_LARGEST >> 20}")
    try:
        root = parsed_xml(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ConfigurationError(f"{name}: is not XML: {error}") from None
    if root.tag != f"{{{DCC}}}{_ROOT}":
        namespace, _, other = root.tag.rpartition("}")
        where = f" in the namespace {namespace.removeprefix('{') or 'of none'}" if other == _ROOT else ""
        remedy = f", whose namespace is {DCC}" if where else ""
        raise ConfigurationError(
            f"{name}: is XML of {other!r}{where}, not a digital calibration certificate (DCC){remedy}"
        )
    schema = root.get("schemaVersion", "")
    if schema.partition(".")[0] != "3":
        raise ConfigurationError(f"{name}: is a certificate of schema {schema or '?'}; 3.x is read here")
    if root.find(f".//{{{SI}}}*") is None and (other := _other_numbers(root)):
        raise ConfigurationError(f"{name}: its numbers are in the namespace {other}; {SI} is read here")
    core = "dcc:administrativeData/dcc:coreData/dcc:"
    began, ended = (_date(root, f"{core}{side}PerformanceDate", name) for side in ("begin", "end"))
    if began and ended and began > ended:
        raise ConfigurationError(f"{name}: its calibration ended ({ended}) before it began ({began})")
    performed = ended or began
    if performed is None:
        raise ConfigurationError(f"{name}: does not say when was calibrated (endPerformanceDate)")
    by = "dcc:administrativeData/dcc:statements/dcc:statement[@refType='basic_recalibration']/dcc:date"
    found = root.findall("dcc:measurementResults/dcc:measurementResult/dcc:results/dcc:result", _NAMES)
    return Certificate(
        schema,
        _text(root, f"{core}uniqueIdentifier"),
        _text(root, "dcc:administrativeData/dcc:calibrationLaboratory/dcc:contact/dcc:name/dcc:content"),
        performed,
        _date(root, by, name),
        _text(root, "dcc:administrativeData/dcc:items/dcc:item/dcc:name/dcc:content"),
        tuple(each for result in found for each in _quantities(result, name)),
    )


def _other_numbers(root: Element) -> str:
    """The namespace of elements called real that are none of D-SI; empty where there are none."""
    tags = (each.tag.rpartition("}") for each in root.iter() if isinstance(each.tag, str))
    return next((above.removeprefix("{") for above, _, tag in tags if tag in ("real", "hybrid")), "")


def _quantities(result: Element, source: str) -> Iterator[CertifiedQuantity]:
    above = _kinds(result)
    # those of a quantity's own conditions and tolerances stand below it, and are no results
    for quantity in (*result.iterfind("dcc:data/dcc:quantity", _NAMES), *_listed(result)):
        name = _english(quantity) or _english(result) or "a quantity without a name"
        kinds = (*_kinds(quantity), *above)
        numbers = quantity.find("si:hybrid", _NAMES)
        numbers = quantity if numbers is None else numbers
        said = [
            each
            for number in numbers
            for each in (
                _real(number, name, kinds, source)
                if number.tag == f"{{{SI}}}real"
                else _real_list(number, name, kinds, source)
                if number.tag == f"{{{SI}}}realListXMLList"
                else ()
            )
        ]
        if numbers.tag == f"{{{SI}}}hybrid":
            # one and the same in several units: the first that is known here and has an uncertainty
            size = max(1, len(said) // max(1, len(numbers)))
            parts = [said[at : at + size] for at in range(0, len(said), size)]
            parts.sort(key=lambda part: (any(each.problem for each in part), math.isnan(part[0].u)))
            said = parts[0] if parts else []
        yield from said


def _listed(result: Element) -> Iterator[Element]:
    lists = result.findall("dcc:data/dcc:list", _NAMES)
    while lists:
        one = lists.pop(0)
        yield from one.findall("dcc:quantity", _NAMES)
        lists = [*one.findall("dcc:list", _NAMES), *lists]


def _real(number: Element, name: str, kinds: tuple[str, ...], source: str) -> Iterator[CertifiedQuantity]:
    what = f"{source}: {name}"
    unit, problem = _unit(number.findtext("si:unit", "", _NAMES))
    value = _number(number.findtext("si:value", "", _NAMES), what)
    u, k, probability = math.nan, math.nan, math.nan
    # D-SI 2.2 puts the same parts, longer named, into an element of their own
    below = number.find("si:measurementUncertaintyUnivariate", _NAMES)
    below = number if below is None else below
    for place, size in (("expandedUnc", "uncertainty"), ("expandedMU", "valueExpandedMU")):
        if (found := below.find(f"si:{place}", _NAMES)) is not None:
            if not found.findtext("si:coverageFactor", "", _NAMES).strip():
                raise ConfigurationError(
                    f"{what}: its expanded uncertainty has no coverage factor, without which it is no "
                    "standard uncertainty; ask the laboratory"
                )
            k = _number(found.findtext("si:coverageFactor", "", _NAMES), f"{what}, coverage factor")
            probability = _number(found.findtext("si:coverageProbability", "nan", _NAMES), what)
            expanded = _number(found.findtext(f"si:{size}", "", _NAMES), f"{what}, uncertainty")
            u = _over(expanded, k, probability, what)
    for place, size in _STANDARD:
        if (stated := below.findtext(f"si:{place}/si:{size}", None, _NAMES)) is not None:
            u, k = _number(stated, f"{what}, uncertainty"), 1.0
    yield CertifiedQuantity(name, value, unit, u, k, probability, kinds, problem)


def _real_list(
    number: Element, name: str, kinds: tuple[str, ...], source: str
) -> Iterator[CertifiedQuantity]:
    what = f"{source}: {name}"
    values = [_number(word, what) for word in number.findtext("si:valueXMLList", "", _NAMES).split()]
    units = number.findtext("si:unitXMLList", "", _NAMES).split()
    below = number.find("si:measurementUncertaintyUnivariateXMLList", _NAMES)
    below = number if below is None else below

    def column(*places: str) -> list[float]:
        texts = [
            below.findtext("/".join(f"si:{part}XMLList" for part in place.split()), None, _NAMES)
            for place in places
        ]
        words = next((text.split() for text in texts if text and text.strip()), ["nan"])
        return [_number(word, what) for word in _for_all(words, len(values), what)]

    expanded = column("expandedUnc uncertainty", "expandedMU valueExpandedMU")
    k = column("expandedUnc coverageFactor", "expandedMU coverageFactor")
    probability = column("expandedUnc coverageProbability", "expandedMU coverageProbability")
    standard = column(*(" ".join(names) for names in _STANDARD))
    for at, text in enumerate(_for_all(units, len(values), what)):
        unit, problem = _unit(text)
        u, factor = (
            (_over(expanded[at], k[at], probability[at], what), k[at])
            if math.isnan(standard[at])
            else (standard[at], 1.0)
        )
        yield CertifiedQuantity(name, values[at], unit, u, factor, probability[at], kinds, problem)


def _for_all(words: list[str], count: int, what: str) -> list[str]:
    """One word that holds for all, or one for each."""
    if len(words) not in (1, count):
        raise ConfigurationError(f"{what}: has {count} values and {len(words)} of what belongs to them")
    return words * count if len(words) == 1 else words


def _over(expanded: float, k: float, probability: float, what: str) -> float:
    """The standard uncertainty of an expanded one, whose coverage factor must be one.

    A factor that covers the probability of no distribution, from an arcsine's to Student's of one degree of
    freedom, would make a standard uncertainty that is wrong by as much.
    """
    if math.isnan(expanded):
        return math.nan
    if not 1 <= k < math.inf:
        raise ConfigurationError(
            f"{what}: its coverage factor is {k:g}; an expanded uncertainty needs one from 1 on"
        )
    if not math.isnan(probability):
        if not 0 < probability < 1:
            raise ConfigurationError(f"{what}: its coverage probability is {probability:g}; 0.95 is 95 %")
        normal = NormalDist().inv_cdf((1 + probability) / 2)
        arcsine = math.sqrt(2) * math.sin(math.pi / 2 * probability)
        student = math.tan(math.pi / 2 * probability)
        if not 0.99 * min(normal, arcsine) <= k <= max(1.01 * student, 1.0):
            raise ConfigurationError(
                f"{what}: its coverage factor {k:g} and its coverage probability {probability:g} do not "
                f"belong together (a normal distribution has {normal:.3g}); ask the laboratory which is right"
            )
    return expanded / k


def _unit(text: str) -> tuple[str, str]:
    try:
        return from_d_si(text), ""
    except ConfigurationError as error:
        return "", str(error)


def _number(text: str, what: str) -> float:
    try:
        # what Python reads beyond XML's numbers
        if "_" in text:
            raise ValueError
        return float(text)
    except ValueError:
        raise ConfigurationError(f"{what}: {text!r} is not a number") from None


def _date(root: Element, place: str, name: str) -> datetime.date | None:
    text = root.findtext(place, "", _NAMES).strip()
    if not text:
        return None
    try:
        return datetime.date.fromisoformat(text[:10])
    except ValueError:
        raise ConfigurationError(f"{name}: {text!r} ({place.rpartition(':')[2]}) is no date") from None


def _text(root: Element, place: str) -> str:
    return " ".join(root.findtext(place, "", _NAMES).split())


def _english(element: Element) -> str:
    """Its name, in English where that is one of its languages."""
    names = element.findall("dcc:name/dcc:content", _NAMES)
    named = next((each for each in names if each.get("lang") == "en"), names[0] if names else None)
    return "" if named is None else " ".join((named.text or "").split())


def _kinds(element: Element) -> tuple[str, ...]:
    own = element.get("id", "")
    return (*element.get("refType", "").split(), *([own] if own else []))
