"""The bill of materials of a release: CycloneDX 1.6, https://cyclonedx.org/docs/1.6/json/."""

from __future__ import annotations

import re
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import Distribution
from typing import Any

from licences import licence
from locked import Pin, project
from packaging.utils import canonicalize_name

# What an environment of Python has of its own, without being asked.
OF_PYTHON = {"pip", "setuptools", "wheel"}


@dataclass(frozen=True, slots=True)
class Wheel:
    """The wheel that a bill is of."""

    version: str
    sha256: str
    built_s: int


def bill(
    wheel: Wheel,
    installed: Iterable[Distribution],
    pinned: Mapping[str, Pin],
    graph: Mapping[str, Iterable[str]],
    first: Iterable[str],
) -> dict[str, Any]:
    """Everything that an installation of the wheel consists of, the same for the same wheel.

    Args:
        wheel: the wheel.
        installed: the packages of an environment into which only the wheel was installed.
        pinned: what the lock file says may be there.
        graph: what each of those asks for.
        first: what the testbed itself asks for.

    Raises:
        ValueError: what is installed is not what is pinned.
    """
    ours = {canonicalize_name(each.metadata["Name"]): each for each in installed}
    there = {
        name: each.version for name, each in ours.items() if name not in OF_PYTHON | {"testbed"}
    }
    meant = {name: pin.version for name, pin in pinned.items()}
    if there != meant:
        differ = sorted(f"{name} {version}" for name, version in there.items() ^ meant.items())
        raise ValueError(f"installed and pinned differ: {', '.join(differ)}")
    # PyPI has a testbed of somebody else: a `pkg:pypi` would be that one.
    root = f"pkg:generic/testbed@{wheel.version}"
    references = {name: f"pkg:pypi/{name}@{pin.version}" for name, pin in pinned.items()}
    asks = {root: first} | {references[name]: graph[name] for name in sorted(pinned)}
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
                "name": "testbed",
                "version": wheel.version,
                "description": project()["description"],
                "licenses": said(str(project()["license"])),
                "hashes": [{"alg": "SHA-256", "content": wheel.sha256}],
                "purl": root,
            },
        },
        "components": [component(pinned[name], licence(ours[name])) for name in sorted(pinned)],
        "dependencies": [
            {"ref": each, "dependsOn": sorted(references[name] for name in names)}
            for each, names in asks.items()
        ],
    }


def component(pin: Pin, of: str) -> dict[str, Any]:
    """One package; the hashes are of the files of which pip takes the one that fits the system."""
    reference = f"pkg:pypi/{pin.name}@{pin.version}"
    return {
        "type": "library",
        "bom-ref": reference,
        "name": pin.name,
        "version": pin.version,
        "licenses": said(of),
        "purl": reference,
        "externalReferences": [
            {
                "type": "distribution",
                "url": f"https://pypi.org/project/{pin.name}/{pin.version}/",
                "hashes": [{"alg": "SHA-256", "content": each} for each in pin.hashes],
            }
        ],
    }


def said(of: str) -> list[dict[str, Any]]:
    """A licence as CycloneDX has it: an expression, a name of SPDX, or a package's own word."""
    if re.search(" (AND|OR|WITH) ", of):
        return [{"expression": of}]
    return [{"license": {"name" if of == "BSD" else "id": of}}]  # which BSD, they do not say
