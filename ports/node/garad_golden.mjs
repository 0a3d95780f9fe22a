// Reads golden cases and writes answers: Node 18, this file alone, little-endian machines.
//
//     const one = readCase(folder);                  // {stage, params, input(name)}
//     const {shape, data} = one.input("means");      // data: a typed array
//     writeNpy(`${out}/color.npy`, [height, width, 3], new Float32Array(color));
//
// The format is in tests/golden/README.md, its schema in tests/golden/case.schema.json. Expected outputs are not read.

import { readFileSync, writeFileSync } from "node:fs";

/** Typed array, name in case.json and numpy's descriptor of each element type. */
const TYPES = [
  [Float32Array, "f32", "<f4"], [Float64Array, "f64", "<f8"], [Int8Array, "i8", "|i1"], [Uint8Array, "u8", "|u1"],
  [Int16Array, "i16", "<i2"], [Uint16Array, "u16", "<u2"], [Int32Array, "i32", "<i4"], [Uint32Array, "u32", "<u4"],
  [BigInt64Array, "i64", "<i8"], [Uint8Array, "bool", "|b1"],
];

/** What JSON has no number for. */
const WORDS = { nan: NaN, inf: Infinity, "-inf": -Infinity };

/** A .npy file of version 1.0 in C order: {shape, data}. */
export function readNpy(path) {
  const file = readFileSync(path);
  if (file.subarray(0, 8).toString("latin1") !== "\x93NUMPY\x01\x00") throw new Error(`${path}: no .npy file of version 1.0`);
  const end = 10 + file.readUInt16LE(8);
  const header = file.subarray(10, end).toString("latin1");
  const part = (pattern) => header.match(pattern)?.[1] ?? (() => { throw new Error(`${path}: header ${header}`); })();
  if (part(/'fortran_order': (\w+)/) !== "False") throw new Error(`${path}: Fortran order; expected C order`);
  const shape = (part(/'shape': \(([\d, ]*)\)/).match(/\d+/g) ?? []).map(Number);
  const descr = part(/'descr': '([^']+)'/);
  const type = TYPES.find((t) => t[2] === descr)?.[0];
  if (!type) throw new Error(`${path}: element type ${descr}`);
  // A copy, so that elements start at a multiple of their size.
  const data = new type(Uint8Array.from(file.subarray(end)).buffer);
  if (data.length !== shape.reduce((n, size) => n * size, 1)) throw new Error(`${path}: shape and number of bytes disagree`);
  return { shape, data };
}

/** Writes a .npy file. The type of `data` decides which tolerance an answer is held to. */
export function writeNpy(path, shape, data) {
  const descr = TYPES.find((t) => t[0] === data.constructor)?.[2];
  if (!descr) throw new Error(`${path}: a typed array is needed`);
  if (data.length !== shape.reduce((n, size) => n * size, 1)) throw new Error(`${path}: ${data.length} numbers for [${shape}]`);
  const sizes = shape.length === 1 ? `${shape[0]},` : shape.join(", ");
  let header = `{'descr': '${descr}', 'fortran_order': False, 'shape': (${sizes}), }`;
  header = header.padEnd(header.length + 63 - ((10 + header.length) % 64)) + "\n";
  const start = Buffer.from("\x93NUMPY\x01\x00\0\0", "latin1");
  start.writeUInt16LE(header.length, 8);
  writeFileSync(path, Buffer.concat([start, Buffer.from(header, "latin1"), Buffer.from(data.buffer, data.byteOffset, data.byteLength)]));
}

/** The inputs and parameters of the case in a folder. */
export function readCase(folder) {
  const { stage, case: name, params, inputs } = JSON.parse(readFileSync(`${folder}/case.json`, "utf8"));
  const input = (key) => {
    const entry = inputs[key];
    if (!entry) throw new Error(`${folder}: no input '${key}'; there is ${Object.keys(inputs).join(", ")}`);
    if (entry.file) return readNpy(`${folder}/${entry.file}`);
    const type = TYPES.find((t) => t[1] === entry.dtype)[0];
    const number = (v) => (type === BigInt64Array ? BigInt(v) : typeof v === "string" ? WORDS[v] : Number(v));
    return { shape: entry.shape, data: type.from([entry.data].flat(Infinity).map(number)) };
  };
  return { stage, name, params, inputs: Object.keys(inputs), input };
}
