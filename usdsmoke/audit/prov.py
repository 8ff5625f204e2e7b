"""Records as W3C PROV: what was made from what, by which run, with which software.

The source stage, grids, style images, settings, features, the network that frames start from, the
look layer and its frames are entities. The run is an activity. usdsmoke, Python and the packages
are software agents. Identifiers are the run's UUID and a name, so documents of several runs can be
put together.

Sources: [PROV-DM2013], [PROV-JSON2013].
"""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from usdsmoke.audit.record import FoundRecord
from usdsmoke.base.machine import check_packages

if TYPE_CHECKING:
    from prov.model import ProvDocument

_TERMS = "usdsmoke"
_SOFTWARE = "software"
_PREFIXES = {_TERMS: "urn:x-usdsmoke:terms:", _SOFTWARE: "urn:x-usdsmoke:software:"}


def prov_document(found: Sequence[FoundRecord]) -> dict[str, Any]:
    """One PROV-JSON document of all records, as JSON values.

    Raises:
        MissingPackage: the package ``prov`` is not installed.
        LayerError: a record cannot be read.
    """
    check_packages("prov")
    from prov.model import ProvDocument

    document = ProvDocument()
    for prefix, uri in _PREFIXES.items():
        document.add_namespace(prefix, uri)
    for number, item in enumerate(found, 1):
        _Run(document, item, f"run{number}").add()
    values: dict[str, Any] = json.loads(document.serialize(format="json") or "{}")
    return values


class _Run:
    """The statements of one record."""

    def __init__(self, document: "ProvDocument", item: FoundRecord, prefix: str) -> None:
        self.document, self.file, self.record = document, item.file, item.record
        self.prefix, self.activity = prefix, f"{prefix}:run"
        document.add_namespace(prefix, f"urn:uuid:{self.record.run}#")

    def add(self) -> None:
        """Add everything to the document."""
        record = self.record
        seconds = {f"seconds_{name}": value for name, value in record.seconds.items()}
        facts = {"seed": record.seed, "platform": record.machine.platform, **seconds}
        self.document.activity(
            self.activity,
            record.created or None,
            record.finished or None,
            self._facts("Stylization", "stylization of smoke", facts),
        )
        styles = [
            self._entity(f"style{number}", "StyleImage", style.name, **asdict(style))
            for number, style in enumerate(record.styles, 1)
        ]
        sources = self._add_sources()
        for entity in (*self._add_inputs(), *styles, *sources.values()):
            self.document.usage(self.activity, entity)
        look = self._entity("look", "LookLayer", self.file.name, file=self.file.name)
        self._generated(look)
        for number, network in enumerate(record.networks, 1):
            label = network.file.rpartition("/")[2]
            self._generated(self._entity(f"trained{number}", "Network", label, **asdict(network)))
        if record.stage:
            self.document.derivation(look, f"{self.prefix}:stage", self.activity)
        self._add_results(sources, styles)
        self._add_agents()

    def _add_inputs(self) -> Iterable[str]:
        record = self.record
        if record.stage:
            yield self._entity("stage", "Stage", record.stage.rpartition("/")[2], file=record.stage)
        settings = json.dumps(record.settings, sort_keys=True, ensure_ascii=False)
        yield self._entity("settings", "Settings", "settings", value=settings)
        if record.features:
            yield self._entity("features", "Features", record.features, sha256=record.features_hash)
        if file := record.start_file:
            name, digest = file.rpartition("/")[2], record.start_hash
            yield self._entity("network", "Network", name, file=file, sha256=digest)

    def _add_sources(self) -> dict[tuple[str, str], str]:
        """Identifiers by file and grid."""
        found: dict[tuple[str, str], str] = {}
        for frame in self.record.frames:
            for source in frame.sources:
                if (source.file, source.grid) not in found:
                    name = f"{source.file.rpartition('/')[2]} {source.grid}"
                    found[source.file, source.grid] = self._entity(
                        f"source{len(found) + 1}",
                        "SourceGrid",
                        name,
                        file=source.file,
                        grid=source.grid,
                        contentHash=source.hash,
                    )
        return found

    def _add_results(self, sources: dict[tuple[str, str], str], styles: Sequence[str]) -> None:
        made_from = {
            frame.file: [sources[source.file, source.grid] for source in frame.sources]
            for frame in self.record.frames
        }
        for number, (file, digest) in enumerate(self.record.results.items(), 1):
            label = file.rpartition("/")[2]
            result = self._entity(
                f"result{number}", "StylizedFrame", label, file=file, contentHash=digest
            )
            self._generated(result)
            for entity in (*made_from.get(file, []), *styles):
                self.document.derivation(result, entity, self.activity)

    def _add_agents(self) -> None:
        for name, version in {"usdsmoke": self.record.version, **self.record.packages}.items():
            agent = f"{_SOFTWARE}:{re.sub(r'[^A-Za-z0-9._-]', '-', f'{name}-{version}')}"
            kind = self.document.valid_qualified_name("prov:SoftwareAgent")
            facts = [("prov:label", name), ("prov:type", kind), (f"{_TERMS}:version", version)]
            self.document.agent(agent, facts)
            plan = f"{self.prefix}:settings" if name == "usdsmoke" else None
            self.document.association(self.activity, agent, plan)

    def _entity(self, place: str, kind: str, label: str, **facts: Any) -> str:
        identifier = f"{self.prefix}:{place}"
        self.document.entity(identifier, self._facts(kind, label, facts))
        return identifier

    def _facts(self, kind: str, label: str, facts: dict[str, Any]) -> list[tuple[str, Any]]:
        name = self.document.valid_qualified_name
        types = [name(f"{_TERMS}:{kind}"), *([name("prov:Plan")] if kind == "Settings" else [])]
        known = [(f"{_TERMS}:{key}", value) for key, value in facts.items() if value != ""]
        return [("prov:label", label), *[("prov:type", each) for each in types], *known]

    def _generated(self, entity: str) -> None:
        self.document.generation(entity, self.activity, self.record.finished or None)
