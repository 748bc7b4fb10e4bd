// Reads a recording with @mcap/core and decodes it with Foxglove's reader of ROS 2 messages.
//
//   node read.mjs FILE TOPIC...
//
// Writes a line of JSON for each message.

import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { open } from "node:fs/promises";

const [file, ...topics] = process.argv.slice(2);
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(await open(file, "r")),
  decompressHandlers: await loadDecompressHandlers(),
});
const decoders = new Map();
const text = new TextDecoder();

for await (const message of reader.readMessages({ topics, validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  if (!decoders.has(message.channelId)) {
    const schema = text.decode(reader.schemasById.get(channel.schemaId).data);
    decoders.set(message.channelId, new MessageReader(parse(schema, { ros2: true })));
  }
  const { msg, data = msg, header } = decoders.get(message.channelId).readMessage(message.data);
  const isText = typeof data === "string";
  console.log(
    JSON.stringify({
      topic: channel.topic,
      kind: isText ? "text" : "data",
      size: data.length,
      first: isText ? parseInt(data, 10) || 0 : data[0] ?? 0,
      frame: header?.frame_id ?? "",
    }),
  );
}
