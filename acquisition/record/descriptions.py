"""Descriptions of topics: each is written twice and states its SHA-256, since MCAP has no checksum for it."""

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from mcap.records import Channel, Schema

OWN_SHA256 = "sha256"
"""Key in a channel's metadata: SHA-256 of the description without this key."""


def sha256_of_description(channel: Channel, schema: Schema) -> str:
    """Hexadecimal SHA-256 over everything that says how a topic's messages are read."""
    texts = sorted(own_texts(channel).items())
    parts = [channel.id, channel.topic, channel.message_encoding, *texts]
    parts += [schema.id, schema.name, schema.encoding]
    return hashlib.sha256(repr(parts).encode() + schema.data).hexdigest()


def own_texts(channel: Channel) -> dict[str, str]:
    """The metadata of a channel without its description's SHA-256."""
    return {key: text for key, text in channel.metadata.items() if key != OWN_SHA256}


@dataclass
class Descriptions:
    """Every copy of every schema and channel that a file holds, in its order."""

    schemas: dict[int, list[Schema]] = field(default_factory=lambda: defaultdict(list))
    channels: list[Channel] = field(default_factory=list)

    def add(self, record: Schema | Channel) -> None:
        """One more copy."""
        if isinstance(record, Schema):
            self.schemas[record.id].append(record)
        else:
            self.channels.append(record)

    def settled(self) -> tuple[dict[int, Schema], dict[int, Channel], list[str], list[str]]:
        """Schemas and channels to read with, topics with a changed copy, topics that nothing proves.

        A copy that agrees with its SHA-256 is taken before any other. A channel that states one and agrees
        with no schema keeps none: its messages cannot be read.
        """
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        changed, unproved = set(), set()
        for channel in self.channels:
            schema = _proof(channel, self.schemas)
            if schema is not None:
                schemas[schema.id], channels[channel.id] = schema, channel
        proved = {channel.topic for channel in channels.values()}
        for channel in self.channels:
            if channel.id in channels:
                if channel != channels[channel.id]:
                    changed.add(channels[channel.id].topic)
            elif OWN_SHA256 in channel.metadata:
                changed.add(channel.topic)
                if channel.topic not in proved:
                    channels[channel.id] = replace(channel, schema_id=0)
            elif channel.topic not in proved:
                channels[channel.id] = channel
                unproved.add(channel.topic)
                copies = self.schemas.get(channel.schema_id, [])
                if copies:
                    schemas.setdefault(channel.schema_id, copies[0])
        changed |= set(_changed_schemas(self.schemas, schemas, channels))
        return schemas, channels, sorted(changed), sorted(unproved)


def _proof(channel: Channel, schemas: Mapping[int, Sequence[Schema]]) -> Schema | None:
    stated = channel.metadata.get(OWN_SHA256)
    for schema in schemas.get(channel.schema_id, ()) if stated else ():
        if sha256_of_description(channel, schema) == stated:
            return schema
    return None


def _changed_schemas(
    copies: Mapping[int, Sequence[Schema]], taken: Mapping[int, Schema], channels: Mapping[int, Channel]
) -> Iterator[str]:
    for channel in channels.values():
        schema = taken.get(channel.schema_id)
        if schema is not None and any(copy != schema for copy in copies.get(channel.schema_id, ())):
            yield channel.topic
