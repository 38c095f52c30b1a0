/**
 * Parses messages of a live page, which consist of sections of its state.
 *
 *     u32 n (little endian) | n bytes of a JSON head | payloads, each aligned to 4 bytes
 *     head = {"json": {name: value}, "bytes": [[name, length]]}
 */

/** @typedef {{json: Map<string, any>, bytes: Map<string, Uint8Array>}} Sections */

const MAX_SECTIONS = 256;

/**
 * Parses a message. The payloads are views of the message.
 * @param {ArrayBuffer} message @returns {Sections}
 * @throws {Error} if the message is invalid
 */
export function readSections(message) {
  if (message.byteLength < 4) throw new Error(`found a message of ${message.byteLength} bytes`);
  const size = new DataView(message).getUint32(0, true);
  if (size > message.byteLength - 4) throw new Error(`found a head of ${size} bytes in ${message.byteLength}`);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 4, size)));
  if (!isTable(head) || !isTable(head.json ?? {}) || !Array.isArray(head.bytes ?? [])) {
    throw new Error("found a head without tables");
  }
  const listed = head.bytes ?? [];
  if (listed.length > MAX_SECTIONS) throw new Error(`found ${listed.length} payloads`);
  const bytes = new Map();
  let at = aligned(4 + size);
  for (const each of listed) {
    const [name, length] = Array.isArray(each) ? each : [];
    if (typeof name !== "string" || !Number.isSafeInteger(length) || length < 0) {
      throw new Error("found a payload without name or length");
    }
    if (at + length > message.byteLength) throw new Error(`found ${name} of ${length} bytes at ${at}`);
    bytes.set(name, new Uint8Array(message, at, length));
    at = aligned(at + length);
  }
  return { json: new Map(Object.entries(head.json ?? {})), bytes };
}

/** @param {unknown} value */
const isTable = (value) => typeof value === "object" && value !== null && !Array.isArray(value);

/** @param {number} at */
const aligned = (at) => (at + 3) & ~3;

/**
 * Copies a payload into an array of the same size.
 * @param {Uint8Array} bytes @param {ArrayBufferView} to @returns {true}
 * @throws {Error} if the array has another size
 */
export function fill(bytes, to) {
  if (bytes.length !== to.byteLength) throw new Error(`found ${bytes.length} bytes, expected ${to.byteLength}`);
  new Uint8Array(to.buffer, to.byteOffset, to.byteLength).set(bytes);
  return true;
}

/** Reads a payload piece by piece. */
export class Reader {
  /** @param {Uint8Array} bytes */
  constructor(bytes) {
    this.bytes = bytes;
    this.at = 0;
  }

  /** Fills an array with the next bytes. @param {ArrayBufferView} to */
  take(to) {
    const end = this.at + to.byteLength;
    if (end > this.bytes.length) throw new Error(`found ${this.bytes.length} bytes, expected ${end}`);
    fill(this.bytes.subarray(this.at, end), to);
    this.at = end;
  }

  /** Reads the number of the following elements, which have at least `each` bytes. @param {number} each */
  count(each) {
    const number = new Uint32Array(1);
    this.take(number);
    const [count] = number;
    if (count * each > this.bytes.length - this.at) throw new Error(`found ${count} elements in ${this.bytes.length} bytes`);
    return count;
  }
}
