// Reads MCAP files with the TypeScript implementation, streamed and indexed, all checksums on.
// Setup, in a folder of its own: npm install @mcap/core@2.2.2 @mcap/support@1.1.0 @mcap/nodejs@1.0.2
// Usage: NODE_PATH is not read by ES modules, so give the folder: node mcap_check.mjs NODE_FOLDER FILE...
import { createRequire } from "node:module";
import { open, readFile } from "node:fs/promises";
import path from "node:path";

const [folder, ...files] = process.argv.slice(2);
const require = createRequire(path.resolve(folder, "package.json"));
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const { FileHandleReadable } = require("@mcap/nodejs");

const decompressHandlers = await loadDecompressHandlers();

async function streamed(file) {
  const reader = new McapStreamReader({ includeChunks: false, decompressHandlers, validateCrcs: true });
  reader.append(await readFile(file));
  let messages = 0;
  for (let record; (record = reader.nextRecord()) != undefined; ) {
    messages += record.type === "Message" ? 1 : 0;
  }
  if (!reader.done()) {
    throw new Error(`${file}: the stream does not end in a footer`);
  }
  return messages;
}

async function indexed(file) {
  const handle = await open(file, "r");
  try {
    const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(handle), decompressHandlers });
    let messages = 0;
    let last = -1n;
    for await (const message of reader.readMessages({ validateCrcs: true })) {
      if (message.logTime < last) {
        throw new Error(`${file}: log times fall`);
      }
      last = message.logTime;
      messages += 1;
    }
    for await (const _ of reader.readMetadata()) {
      // reading is the test
    }
    for await (const attachment of reader.readAttachments({ validateCrcs: true })) {
      JSON.parse(new TextDecoder().decode(attachment.data));
    }
    if (reader.statistics.messageCount !== BigInt(messages)) {
      throw new Error(`${file}: the summary counts ${reader.statistics.messageCount} messages, the index finds ${messages}`);
    }
    return messages;
  } finally {
    await handle.close();
  }
}

if (files.length === 0) {
  throw new Error("give at least one MCAP file");
}
for (const file of files) {
  const [a, b] = [await streamed(file), await indexed(file)];
  if (a !== b || a === 0) {
    throw new Error(`${file}: ${a} messages streamed, ${b} by index`);
  }
  console.log(`${path.basename(file)}: ${a} messages, streamed and indexed, checksums right`);
}
