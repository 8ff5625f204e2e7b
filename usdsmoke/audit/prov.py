"""Records as W3C PROV-JSON: what was made from what, by which run, with which software.

The source stage, VDB files, style images, settings, the look layer and its frames are entities, the
run is an activity, usdsmoke and the packages beneath it are software agents. Identifiers are the
run's UUID and a number, so documents of several runs can be put together.

Sources: [PROV-DM2013], [PROV-JSON2013].
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from usdsmoke.audit.records import LookRecord, split_pair

__all__ = ["prov_document"]

_TERMS = "usdsmoke"
_SOFTWARE = "software"
_PREFIXES = {_TERMS: "urn:x-usdsmoke:terms:", _SOFTWARE: "urn:x-usdsmoke:software:"}

Statement = dict[str, Any]


def prov_document(records: Sequence[LookRecord]) -> dict[str, Any]:
    """One PROV-JSON document of all records.

    Args:
        records: from ``find_records``.
    """
    document: dict[str, Any] = {"prefix": dict(_PREFIXES)}
    for number, record in enumerate(records, 1):
        _Run(document, record, number).add()
    return document


class _Run:
    """The statements of one record."""

    def __init__(self, document: dict[str, Any], record: LookRecord, number: int) -> None:
        self.document = document
        self.record = record
        self.values = record.values
        self.prefix = f"run{number}"
        document["prefix"][self.prefix] = f"urn:uuid:{record.values['run']}#"
        self.activity = f"{self.prefix}:run"
        self.time = str(self.values.get("finished", ""))

    def add(self) -> None:
        """Add everything to the document."""
        self._add_activity()
        inputs = [
            *self._add_stage(),
            *self._add_settings(),
            *self._add_features(),
            *(styles := self._add_styles()),
            *(sources := self._add_sources()).values(),
        ]
        for entity in inputs:
            self._relate("used", activity=self.activity, entity=entity)
        look = self._entity("look", "LookLayer", self.record.file.name, file=self.record.file.name)
        self._generated(look)
        if self.record.request():
            self._derived(look, f"{self.prefix}:stage")
        for result, made_from in self._add_results(sources):
            self._generated(result)
            for entity in (*made_from, *styles):
                self._derived(result, entity)
        self._add_agents()

    def _add_activity(self) -> None:
        facts = {
            "prov:startTime": self.values.get("created"),
            "prov:endTime": self.values.get("finished"),
            "prov:label": "stylization of smoke",
            "prov:type": _name(f"{_TERMS}:Stylization"),
            f"{_TERMS}:seed": self.values.get("seed"),
            f"{_TERMS}:platform": self.values.get("platform"),
        }
        for name, seconds in self.record.pairs("timings").items():
            facts[f"{_TERMS}:seconds_{name}"] = {"$": seconds, "type": "xsd:double"}
        self._put("activity", self.activity, facts)

    def _add_stage(self) -> list[str]:
        stage = self.record.request().get("stage")
        if not stage:
            return []
        return [self._entity("stage", "Stage", stage.rpartition("/")[2], file=stage)]

    def _add_settings(self) -> list[str]:
        settings = self.values.get("config")
        return [self._entity("settings", "Settings", "settings", value=settings)]

    def _add_features(self) -> list[str]:
        name, digest = self.values.get("features", ""), self.values.get("featuresHash", "")
        return [self._entity("features", "Features", name, sha256=digest)] if name else []

    def _add_styles(self) -> list[str]:
        texts = self.record.texts("styleFiles") or self.record.texts("styles")
        found = []
        for number, (name, digest) in enumerate(map(split_pair, texts), 1):
            label = name.rpartition("/")[2]
            place = f"style{number}"
            found.append(self._entity(place, "StyleImage", label, file=name, sha256=digest))
        return found

    def _add_sources(self) -> dict[tuple[str, str], str]:
        """Identifiers by file and grid."""
        found: dict[tuple[str, str], str] = {}
        for frame in self.record.frames():
            for source in frame["sources"]:
                key = (source["file"], source["grid"])
                if key not in found:
                    found[key] = self._entity(
                        f"source{len(found) + 1}",
                        "SourceGrid",
                        f"{key[0].rpartition('/')[2]} {key[1]}",
                        file=key[0],
                        grid=key[1],
                        contentHash=source["hash"],
                    )
        return found

    def _add_results(
        self, sources: Mapping[tuple[str, str], str]
    ) -> list[tuple[str, Sequence[str]]]:
        """Identifier of every file of the result, and what it was made from."""
        made_from = {
            frame["file"]: [sources[source["file"], source["grid"]] for source in frame["sources"]]
            for frame in self.record.frames()
        }
        found: list[tuple[str, Sequence[str]]] = []
        for number, (file, digest) in enumerate(self.record.pairs("results").items(), 1):
            label, place = file.rpartition("/")[2], f"result{number}"
            entity = self._entity(place, "StylizedFrame", label, file=file, contentHash=digest)
            found.append((entity, made_from.get(file, [])))
        return found

    def _add_agents(self) -> None:
        versions = {"usdsmoke": str(self.values.get("version", ""))}
        versions |= self.record.pairs("packages")
        for name, version in versions.items():
            agent = f"{_SOFTWARE}:{re.sub(r'[^A-Za-z0-9._-]', '-', f'{name}-{version}')}"
            kind = _name("prov:SoftwareAgent")
            facts = {"prov:type": kind, "prov:label": name, f"{_TERMS}:version": version}
            self._put("agent", agent, facts)
            plan = {"prov:plan": f"{self.prefix}:settings"} if name == "usdsmoke" else {}
            self._relate("wasAssociatedWith", more=plan, activity=self.activity, agent=agent)

    def _entity(self, place: str, kind: str, label: str, **facts: Any) -> str:
        identifier = f"{self.prefix}:{place}"
        known = {f"{_TERMS}:{name}": value for name, value in facts.items()}
        kinds = [_name(f"{_TERMS}:{kind}"), *([_name("prov:Plan")] if kind == "Settings" else [])]
        self._put("entity", identifier, {"prov:label": label, "prov:type": kinds, **known})
        return identifier

    def _generated(self, entity: str) -> None:
        facts = {"prov:time": self.time} if self.time else {}
        self._relate("wasGeneratedBy", entity=entity, activity=self.activity, more=facts)

    def _derived(self, entity: str, source: str) -> None:
        self._relate(
            "wasDerivedFrom", generatedEntity=entity, usedEntity=source, activity=self.activity
        )

    def _relate(self, kind: str, more: Mapping[str, str] | None = None, **ends: str) -> None:
        statements = self.document.setdefault(kind, {})
        named = {f"prov:{name}": value for name, value in ends.items()}
        statements[f"_:{kind}{len(statements) + 1}"] = {**named, **(more or {})}

    def _put(self, section: str, identifier: str, facts: Mapping[str, Any]) -> None:
        kept = {name: value for name, value in facts.items() if value not in (None, "")}
        self.document.setdefault(section, {})[identifier] = kept


def _name(qualified: str) -> Statement:
    return {"$": qualified, "type": "prov:QUALIFIED_NAME"}
