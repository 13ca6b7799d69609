"""Certificates for tests: small ones written by hand, and the schema, which is not part of the project."""

from pathlib import Path
from typing import Any

import pytest

EXAMPLE = "dcc_gp_humidity_v1.0.xml"
_HEAD = """<?xml version="1.0" encoding="utf-8"?>
<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si"
    schemaVersion="{schema}">
  <dcc:administrativeData>
    <dcc:dccSoftware><dcc:software>
      <dcc:name><dcc:content>an editor</dcc:content></dcc:name><dcc:release>1</dcc:release>
    </dcc:software></dcc:dccSoftware>
    <dcc:coreData>
      <dcc:countryCodeISO3166_1>DE</dcc:countryCodeISO3166_1>
      <dcc:usedLangCodeISO639_1>en</dcc:usedLangCodeISO639_1>
      <dcc:mandatoryLangCodeISO639_1>en</dcc:mandatoryLangCodeISO639_1>
      <dcc:uniqueIdentifier>M-2025-17</dcc:uniqueIdentifier>
      <dcc:beginPerformanceDate>2025-03-01</dcc:beginPerformanceDate>
      <dcc:endPerformanceDate>2025-03-02</dcc:endPerformanceDate>
      <dcc:performanceLocation>laboratory</dcc:performanceLocation>
    </dcc:coreData>
    <dcc:items><dcc:item>
      <dcc:name><dcc:content lang="de">Pendel</dcc:content></dcc:name>
      <dcc:manufacturer><dcc:name><dcc:content>nobody</dcc:content></dcc:name></dcc:manufacturer>
      <dcc:identifications><dcc:identification>
        <dcc:issuer>owner</dcc:issuer><dcc:value>1</dcc:value>
      </dcc:identification></dcc:identifications>
    </dcc:item></dcc:items>
    <dcc:calibrationLaboratory><dcc:contact>
      <dcc:name><dcc:content>A Laboratory</dcc:content></dcc:name><dcc:eMail>a@b.example</dcc:eMail>
      <dcc:location><dcc:city>C</dcc:city></dcc:location>
    </dcc:contact></dcc:calibrationLaboratory>
    <dcc:respPersons><dcc:respPerson>
      <dcc:person><dcc:name><dcc:content>D. E.</dcc:content></dcc:name></dcc:person>
    </dcc:respPerson></dcc:respPersons>
    <dcc:customer>
      <dcc:name><dcc:content>F</dcc:content></dcc:name><dcc:eMail>f@b.example</dcc:eMail>
      <dcc:location><dcc:city>G</dcc:city></dcc:location>
    </dcc:customer>{statements}
  </dcc:administrativeData>
  <dcc:measurementResults><dcc:measurementResult>
    <dcc:name><dcc:content>weighed</dcc:content></dcc:name>
    <dcc:results><dcc:result>
      <dcc:name><dcc:content>results</dcc:content></dcc:name>
      <dcc:data>"""
_FOOT = """</dcc:data>
    </dcc:result></dcc:results>
  </dcc:measurementResult></dcc:measurementResults>
</dcc:digitalCalibrationCertificate>
"""
BY = """
    <dcc:statements><dcc:statement refType="basic_recalibration"><dcc:date>{date}</dcc:date></dcc:statement>
    </dcc:statements>"""


def real(value: str, unit: str, expanded: str = "", k: str = "2", probability: str = "0.95") -> str:
    """A number in D-SI, with an expanded uncertainty where one is stated."""
    said = (
        f"<si:expandedUnc><si:uncertainty>{expanded}</si:uncertainty><si:coverageFactor>{k}</si:coverageFactor>"
        f"<si:coverageProbability>{probability}</si:coverageProbability></si:expandedUnc>"
    )
    return (
        f"<si:real><si:value>{value}</si:value><si:unit>{unit}</si:unit>{said if expanded else ''}</si:real>"
    )


def quantity(name: str, number: str, kinds: str = "") -> str:
    """A quantity with its name and its reference types."""
    kinds = f' refType="{kinds}"' if kinds else ""
    said = f'<dcc:name><dcc:content lang="en">{name}</dcc:content></dcc:name>'
    return f"<dcc:quantity{kinds}>{said}{number}</dcc:quantity>"


def certificate(path: Path, *quantities: str, recalibrate_by: str = "", schema: str = "3.1.2") -> Path:
    """Write a certificate of these quantities."""
    statements = BY.format(date=recalibrate_by) if recalibrate_by else ""
    text = _HEAD.format(schema=schema, statements=statements) + "".join(quantities) + _FOOT
    path.write_text(text, encoding="utf-8")
    return path


def schema(shared_data: Path) -> Any:
    """PTB's schema 3.1.2 as xmlschema reads it; skips without either.

    It is under the LGPL, and stays outside a project under the MIT licence.
    """
    xmlschema = pytest.importorskip("xmlschema", reason="xmlschema is not installed")
    folder = shared_data / "dcc"
    if not (folder / "dcc.xsd").is_file():
        pytest.skip(f"no schema of certificates at {folder}")
    return xmlschema.XMLSchema(
        str(folder / "dcc.xsd"), locations={"https://ptb.de/si": str(folder / "SI_Format.xsd")}
    )
