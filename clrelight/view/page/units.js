// Units of klt 4 as docs/bitstream.md describes them: streams of rANS, what they learn, LL and the other subbands.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { demand } = clrelight;

  const CONTEXTS = 592;
  const SYMBOLS = 16;
  const FLAGS = 144;
  const ONE = 1 << 14;
  const TABLES_BYTES = CONTEXTS * SYMBOLS + 4 * FLAGS;
  const LARGEST = 1 << 28;
  const PITCH = 66; // of sizes: the largest unit, and a border

  /** Words from the front by four states, raw bits from the back. Every read is within the bytes, or refused. */
  class Stream {
    constructor(bytes) {
      demand(bytes.length >= 16, "a stream is shorter than its states");
      this.bytes = bytes;
      this.at = 16;
      this.end = bytes.length;
      this.bits = 0;
      this.held = 0;
      const view = new DataView(bytes.buffer, bytes.byteOffset, 16);
      this.states = [0, 4, 8, 12].map((at) => view.getUint32(at, true));
    }

    take(lane, begin, size) {
      const old = this.states[lane];
      let state = size * (old >>> 14) + (old & (ONE - 1)) - begin;
      if (state < 65536) {
        demand(this.at + 2 <= this.end, "a word is missing");
        state = state * 65536 + (this.bytes[this.at] | (this.bytes[this.at + 1] << 8));
        this.at += 2;
      }
      this.states[lane] = state;
    }

    takeBits(count) {
      if (count > 16) {
        const low = this.takeBits(16);
        return low + this.takeBits(count - 16) * 65536;
      }
      while (this.held < count) {
        demand(this.end > this.at, "a raw bit is missing");
        this.bits |= this.bytes[--this.end] << this.held;
        this.held += 8;
      }
      const value = this.bits & ((1 << count) - 1);
      this.bits >>>= count;
      this.held -= count;
      return value;
    }

    takeLarge(order) {
      let octave = order;
      while (!this.takeBits(1)) demand(++octave < 28, "a number is too large");
      return 2 ** octave + this.takeBits(octave) - 2 ** order;
    }

    takeMagnitude(symbol, shift, order) {
      const whole = symbol === SYMBOLS - 1 ? symbol + this.takeLarge(order) : symbol;
      demand(whole * 2 ** shift <= LARGEST, "a magnitude is too large");
      return whole * 2 ** shift + (shift ? this.takeBits(shift) : 0);
    }

    finish() {
      demand(this.at === this.end && this.bits === 0, "bytes are left of a stream");
      demand(this.states.every((state) => state === 65536), "states are left of a stream");
    }
  }

  /** What a stream learns, from the tables that are part of the format (10 048 bytes). */
  class Tables {
    constructor(start) {
      demand(start.length === TABLES_BYTES, "the start tables have another length");
      this.counts = Int32Array.from(start.subarray(0, CONTEXTS * SYMBOLS));
      this.zero = new Int32Array(FLAGS);
      this.seen = new Int32Array(FLAGS);
      for (let i = 0; i < FLAGS; i++) {
        const at = CONTEXTS * SYMBOLS + 4 * i;
        this.zero[i] = start[at] | (start[at + 1] << 8);
        this.seen[i] = start[at + 2] | (start[at + 3] << 8);
      }
      this.left = new Int32Array(CONTEXTS * (SYMBOLS + 1));
      this.patience = new Int32Array(CONTEXTS);
      this.ready = new Uint8Array(CONTEXTS);
    }

    share(context) {
      const { counts, left } = this;
      const first = context * SYMBOLS;
      let total = 0;
      for (let s = 0; s < SYMBOLS; s++) total += counts[first + s];
      if (total > 6144) {
        total = 0;
        for (let s = 0; s < SYMBOLS; s++) total += counts[first + s] = (counts[first + s] + 1) >> 1;
      }
      const scale = Math.floor(((ONE - SYMBOLS) << 16) / total);
      const begin = context * (SYMBOLS + 1);
      for (let s = 0, before = 0; s < SYMBOLS; s++) {
        left[begin + s] = ((scale * before) >> 16) + s;
        before += counts[first + s];
      }
      left[begin + SYMBOLS] = ONE;
      this.patience[context] = Math.max(12, total >> 2);
      this.ready[context] = 1;
    }

    takeSymbol(stream, context, lane) {
      if (!this.ready[context]) this.share(context);
      const begin = context * (SYMBOLS + 1);
      const slot = stream.states[lane] & (ONE - 1);
      let symbol = 0;
      while (this.left[begin + symbol + 1] <= slot) symbol++;
      const low = this.left[begin + symbol];
      stream.take(lane, low, this.left[begin + symbol + 1] - low);
      this.counts[context * SYMBOLS + symbol]++;
      this.patience[context]--;
      return symbol;
    }

    learn(contexts, count) {
      for (let i = 0; i < count; i++) if (this.patience[contexts[i]] <= 0) this.share(contexts[i]);
    }

    takeFlag(stream, flag) {
      const zero = this.zero[flag];
      const many = this.seen[flag] + 2;
      const value = (stream.states[0] & (ONE - 1)) >= zero ? 1 : 0;
      if (value) stream.take(0, zero, ONE - zero);
      else stream.take(0, 0, zero);
      const moved = value ? -Math.floor(zero / many) : Math.floor((ONE - zero) / many);
      this.zero[flag] = Math.min(Math.max(zero + moved, 24), ONE - 24);
      this.seen[flag] = Math.min(this.seen[flag] + 1, 62);
      return value;
    }
  }

  const bitsOf = (value) => 32 - Math.clz32(value);

  function classOf(activity) {
    if (activity < 2) return activity;
    const bits = 32 - Math.clz32(activity);
    return 2 * (bits - 1) + ((activity >> (bits - 2)) & 1);
  }

  const rowContexts = new Int32Array(PITCH);

  function expectedLow(values, at, x, y, width) {
    if (!x || !y) return x ? values[at - 1] : y ? values[at - width] : 0;
    const left = values[at - 1];
    const up = values[at - width];
    const sum = left + up - values[at - width - 1];
    return Math.max(Math.min(left, up), Math.min(Math.max(left, up), sum)); // the median
  }

  /** Decode LL of a unit: integers [plane, row, column]. */
  function decodeLow(stream, tables, planes, rows, columns) {
    const values = new Int32Array(planes * rows * columns);
    const before = new Int32Array(rows * columns);
    for (let plane = 0; plane < planes; plane++) {
      const value = values.subarray(plane * rows * columns, (plane + 1) * rows * columns);
      const size = new Float64Array((rows + 1) * (columns + 2));
      for (let y = 0; y < rows; y++) {
        for (let x = 0; x < columns; x++) {
          const at = y * columns + x;
          const here = (y + 1) * (columns + 2) + x + 1;
          const up = here - columns - 2;
          let known = 2 * (size[here - 1] + size[up]) + size[up - 1] + size[up + 1] + (plane ? 2 * before[at] : 0);
          if (!plane && !x && !y) known = 64;
          const k = Math.min(bitsOf(known + 1) - 1, 24);
          const context = 576 + Math.min(k, 15);
          rowContexts[x] = context;
          const magnitude = stream.takeMagnitude(tables.takeSymbol(stream, context, 0), Math.max(k - 4, 0), 0);
          size[here] = magnitude;
          const residual = magnitude && stream.takeBits(1) ? -magnitude : magnitude;
          const found = expectedLow(value, at, x, y, columns) + residual;
          demand(Math.abs(found) <= LARGEST, "a value of LL is too large");
          value[at] = found;
        }
        tables.learn(rowContexts, columns);
      }
      for (let y = 0; y < rows; y++)
        for (let x = 0; x < columns; x++) {
          const at = y * columns + x;
          before[at] = (before[at] + size[(y + 1) * (columns + 2) + x + 1]) >> 1;
        }
    }
    return values;
  }

  Object.assign(clrelight, { Stream, Tables, classOf, bitsOf, decodeLow, PITCH });
})();
