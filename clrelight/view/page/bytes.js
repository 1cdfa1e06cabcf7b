// What all scripts of the page share: the name space, refusals, checksums, and floats of 16 bits.
//
// Scripts are plain ones, read one after another: so the page works from disk, and workers are made of the same text.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});

  /** What docs/bitstream.md says that no decoder takes. */
  class Refused extends Error {
    constructor(what) {
      super(what);
      this.name = "Refused";
    }
  }

  function demand(condition, what) {
    if (!condition) throw new Refused(what);
  }

  const CRC_TABLE = new Uint16Array(256);
  for (let i = 0; i < 256; i++) {
    let value = i << 8;
    for (let bit = 0; bit < 8; bit++) value = value & 0x8000 ? (value << 1) ^ 0x1021 : value << 1;
    CRC_TABLE[i] = value;
  }

  /** CRC-16 with x^16 + x^12 + x^5 + 1 from 0 on, bytes from their highest bit ("XMODEM"). */
  function crc16(bytes, sum = 0) {
    for (let i = 0; i < bytes.length; i++) sum = ((sum << 8) & 0xffff) ^ CRC_TABLE[(sum >> 8) ^ bytes[i]];
    return sum;
  }

  const asFloat = new Float32Array(1);
  const asBits = new Uint32Array(asFloat.buffer);

  /** Bits of the nearest float of 16 bits; what is beyond them is the largest, NaN is 0. */
  function toHalf(value) {
    asFloat[0] = value;
    const bits = asBits[0];
    const sign = (bits >>> 16) & 0x8000;
    const size = bits & 0x7fffffff;
    if (size > 0x7f800000) return 0;
    if (size >= 0x477ff000) return sign | 0x7bff;
    if (size < 0x38800000) return sign | Math.round(Math.abs(value) * 16777216);
    return sign | ((size - 0x38000000 + 0xfff + ((size >>> 13) & 1)) >>> 13);
  }

  function fromHalf(bits) {
    const exponent = (bits >> 10) & 31;
    const part = bits & 1023;
    const size = exponent ? 2 ** (exponent - 15) * (1 + part / 1024) : part * 2 ** -24;
    return bits & 0x8000 ? -size : size;
  }

  /** Bytes of base64; a typed loop, since data: URLs would be requests. */
  function fromBase64(text) {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const raw = atob(text);
    const bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return bytes;
  }

  /** Numbers of little-endian float32 in base64, which is what every machine with WebGL has. */
  function floatsOf(text) {
    return new Float32Array(fromBase64(text).buffer);
  }

  Object.assign(clrelight, { Refused, demand, crc16, toHalf, fromHalf, fromBase64, floatsOf });
})();
