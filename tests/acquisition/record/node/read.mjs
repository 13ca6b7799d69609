// Reads a record with Foxglove's own reader and prints what it found as JSON; doubles as hexadecimal bytes.
import { open } from "node:fs/promises";
import { createReadStream } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";

const [folder, path, mode] = process.argv.slice(2);
const require = createRequire(join(folder, "package.json"));
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const protobuf = require("protobufjs");
const descriptors = require("protobufjs/ext/descriptor");

const schemas = new Map();
const channels = new Map();
const types = new Map();
const found = { counts: {}, spots: [], images: [], logs: [], metadata: {}, attachments: {}, times: {} };

function typeOf(channel) {
  if (!types.has(channel.id)) {
    const schema = schemas.get(channel.schemaId);
    const root = protobuf.Root.fromDescriptor(descriptors.FileDescriptorSet.decode(schema.data));
    types.set(channel.id, root.lookupType(schema.name));
  }
  return types.get(channel.id);
}

function hex(number) {
  const bytes = Buffer.alloc(8);
  bytes.writeDoubleLE(number);
  return bytes.toString("hex");
}

function take(message) {
  const channel = channels.get(message.channelId);
  const topic = channel.topic;
  const value = typeOf(channel).decode(message.data);
  found.counts[topic] = (found.counts[topic] ?? 0) + 1;
  (found.times[topic] ??= []).push(message.logTime.toString());
  if (topic === "/spot") {
    const spot = {};
    for (const field of typeOf(channel).fieldsArray) {
      const name = field.name.replace(/([A-Z])/g, (letter) => "_" + letter.toLowerCase());
      spot[name] = field.type === "double" ? hex(value[field.name]) : value[field.name].toString();
    }
    found.spots.push(spot);
  } else if (topic === "/preview") {
    found.images.push([value.format, Buffer.from(value.data).toString("base64")]);
  } else if (topic === "/log") {
    found.logs.push(value.message);
  }
}

const decompressHandlers = await loadDecompressHandlers();
if (mode === "indexed") {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, length) => {
      const bytes = new Uint8Array(Number(length));
      await file.read(bytes, 0, Number(length), Number(offset));
      return bytes;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  for (const [id, schema] of reader.schemasById) schemas.set(id, schema);
  for (const [id, channel] of reader.channelsById) channels.set(id, channel);
  for await (const message of reader.readMessages()) take(message);
  for await (const entry of reader.readMetadata()) found.metadata[entry.name] = Object.fromEntries(entry.metadata);
  for await (const entry of reader.readAttachments()) found.attachments[entry.name] = entry.data.byteLength;
  found.stated = Number(reader.statistics.messageCount);
  await file.close();
} else {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  for await (const part of createReadStream(path)) {
    reader.append(part);
    for (let record; (record = reader.nextRecord()); ) {
      if (record.type === "Schema") schemas.set(record.id, record);
      else if (record.type === "Channel") channels.set(record.id, record);
      else if (record.type === "Message") take(record);
      else if (record.type === "Metadata") found.metadata[record.name] = Object.fromEntries(record.metadata);
      else if (record.type === "Attachment") found.attachments[record.name] = record.data.byteLength;
    }
  }
  found.done = reader.done();
}
console.log(JSON.stringify(found));
