// What somebody sees of a record who has an MCAP reader and nothing else: no protobuf library, no code of ours.
// Prints the decay (UTC in s, amplitude in seconds of arc) and all that the file says about it.
import { open } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";

const [folder, path] = process.argv.slice(2);
const require = createRequire(join(folder, "package.json"));
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");

function* fields(bytes) {
  // the wire format of protobuf: [number, value], a value being a BigInt or bytes
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  const varint = () => {
    let value = 0n;
    for (let shift = 0n; ; shift += 7n) {
      const byte = view.getUint8(at++);
      value |= BigInt(byte & 127) << shift;
      if (byte < 128) return value;
    }
  };
  while (at < bytes.byteLength) {
    const key = Number(varint());
    const wire = key & 7;
    if (wire === 0) {
      yield [key >> 3, varint()];
    } else {
      const length = wire === 1 ? 8 : Number(varint());
      yield [key >> 3, bytes.subarray(at, at + length)];
      at += length;
    }
  }
}
const all = (bytes, number) => [...fields(bytes)].filter(([n]) => n === number).map(([, value]) => value);
const text = (bytes) => new TextDecoder().decode(bytes);

const file = await open(path);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const bytes = new Uint8Array(Number(length));
    await file.read(bytes, 0, Number(length), Number(offset));
    return bytes;
  },
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
const channel = [...reader.channelsById.values()].find((each) => each.topic === "/swing");
const schema = reader.schemasById.get(channel.schemaId);

// FileDescriptorSet.file[0]: message_type[0] and the comments (source_code_info.location)
const [description] = all(schema.data, 1);
const [message] = all(description, 4);
const numbers = {};
const names = all(message, 2).map((field) => {
  const name = text(all(field, 1)[0]);
  numbers[name] = Number(all(field, 3)[0]);
  return name;
});
const enums = all(message, 4).map((each) => [
  text(all(each, 1)[0]),
  Object.fromEntries(
    all(each, 2).map((value) => [text(all(value, 1)[0]), Number(BigInt.asIntN(32, all(value, 2)[0] ?? 0n))]),
  ),
]);
const comments = {};
for (const location of all(all(description, 9)[0], 1)) {
  const [packed] = all(location, 1);
  if (packed.length === 4 && packed[2] === 2) comments[names[packed[3]]] = text(all(location, 3)[0]).trim();
}

const decay = [];
for await (const item of reader.readMessages({ topics: ["/swing"] })) {
  const parts = new Map(fields(item.data));
  const number = (name) => {
    const bytes = parts.get(numbers[name]);
    return new DataView(bytes.buffer, bytes.byteOffset, 8);
  };
  if (number("flags").getBigInt64(0, true) === 0n) {
    decay.push([Number(item.logTime) * 1e-9, number("amplitude_arcsec").getFloat64(0, true)]);
  }
}
const attachments = {};
for await (const entry of reader.readAttachments()) attachments[entry.name] = text(entry.data);
await file.close();
console.log(JSON.stringify({ decay, comments, enums: Object.fromEntries(enums), attachments }));
