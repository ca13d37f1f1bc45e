"""Write the bill of materials of a release: CycloneDX 1.6, https://cyclonedx.org/docs/1.6/json/."""

from __future__ import annotations

import re
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import Distribution
from typing import Any

from licences import licence
from locked import Pin, distribution_name, project
from packaging.utils import canonicalize_name

# Packages that every Python environment has.
OF_PYTHON = {"pip", "setuptools", "wheel"}


@dataclass(frozen=True, slots=True)
class Wheel:
    """The wheel of a release."""

    version: str
    sha256: str
    built_s: int


def make_bill(
    wheel: Wheel,
    installed: Iterable[Distribution],
    pinned: Mapping[str, Pin],
    graph: Mapping[str, Iterable[str]],
    first: Iterable[str],
) -> dict[str, Any]:
    """Return the bill of materials of an installation; the same wheel gives the same bill.

    Args:
        wheel: the wheel.
        installed: the packages of an environment into which only the wheel was installed.
        pinned: the pins of the lock file, by name.
        graph: the requirements of each package.
        first: the requirements of the testbed itself.

    Raises:
        ValueError: installed and pinned packages differ.
    """
    ours = {canonicalize_name(each.metadata["Name"]): each for each in installed}
    found = {
        name: each.version
        for name, each in ours.items()
        if name not in OF_PYTHON | {distribution_name()}
    }
    expected = {name: pin.version for name, pin in pinned.items()}
    if found != expected:
        differ = sorted(f"{name} {version}" for name, version in found.items() ^ expected.items())
        raise ValueError(f"installed and pinned differ: {', '.join(differ)}")
    # not pkg:pypi, which would name the package of any publisher on PyPI
    root = f"pkg:generic/{distribution_name()}@{wheel.version}"
    references = {name: f"pkg:pypi/{name}@{pin.version}" for name, pin in pinned.items()}
    requirements = {root: first} | {references[name]: graph[name] for name in sorted(pinned)}
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, wheel.sha256)}",
        "version": 1,
        "metadata": {
            "timestamp": datetime.fromtimestamp(wheel.built_s, UTC).isoformat(),
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": distribution_name(),
                "version": wheel.version,
                "description": project()["description"],
                "licenses": licence_entry(str(project()["license"])),
                "hashes": [{"alg": "SHA-256", "content": wheel.sha256}],
                "purl": root,
            },
        },
        "components": [component(pinned[name], licence(ours[name])) for name in sorted(pinned)],
        "dependencies": [
            {"ref": each, "dependsOn": sorted(references[name] for name in names)}
            for each, names in requirements.items()
        ],
    }


def component(pin: Pin, of: str) -> dict[str, Any]:
    """Return the entry of a package, with the hashes of all files that pip may choose from."""
    reference = f"pkg:pypi/{pin.name}@{pin.version}"
    return {
        "type": "library",
        "bom-ref": reference,
        "name": pin.name,
        "version": pin.version,
        "licenses": licence_entry(of),
        "purl": reference,
        "externalReferences": [
            {
                "type": "distribution",
                "url": f"https://pypi.org/project/{pin.name}/{pin.version}/",
                "hashes": [{"alg": "SHA-256", "content": each} for each in pin.hashes],
            }
        ],
    }


def licence_entry(of: str) -> list[dict[str, Any]]:
    """Return a licence for CycloneDX: an expression, an SPDX id, or the package's own name."""
    if re.search(" (AND|OR|WITH) ", of):
        return [{"expression": of}]
    return [{"license": {"name" if of == "BSD" else "id": of}}]  # without a clause count
