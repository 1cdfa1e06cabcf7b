// Body 4 of klt: its head, where its streams lie, and units as they are asked for (docs/bitstream.md).
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { demand, crc16, Stream, Tables, decodeLow, decodeDetails } = clrelight;

  const HEAD_SIZE = 15;
  const LEVELS = 5;
  const SIDES = [16, 64, 64, 64, 32, 16]; // by level; 0 is LL
  const TOGETHER = 1 << 18;
  const MOST_PIXELS = 2 ** 40;
  const MOST_VALUES = 2 ** 28;

  const halved = (side, level) => Math.floor((side - 1) / 2 ** level) + 1;

  /** Rows and columns of the subbands HL, LH and HH of a level. */
  function bandShapes(height, width, level) {
    const [h, w] = [halved(height, level - 1), halved(width, level - 1)];
    const [lowH, lowW] = [halved(height, level), halved(width, level)];
    return [
      { height: lowH, width: w - lowW },
      { height: h - lowH, width: lowW },
      { height: h - lowH, width: w - lowW },
    ];
  }

  /** All units in their order, and of each level where its units begin, and how many are in a row. */
  function layOut(height, width) {
    const grids = [];
    let count = 0;
    for (const level of [0, 5, 4, 3, 2, 1]) {
      const [h, w] = [halved(height, level || LEVELS), halved(width, level || LEVELS)];
      const side = SIDES[level];
      const grid = { level, side, first: count, rows: Math.ceil(h / side), columns: Math.ceil(w / side), h, w };
      grids[level] = grid;
      count += grid.rows * grid.columns;
    }
    return { grids, count };
  }

  function parseHead(bytes, channels, coefficients) {
    demand(bytes.length >= HEAD_SIZE, "a body is shorter than its head");
    const view = new DataView(bytes.buffer, bytes.byteOffset, HEAD_SIZE);
    const head = {
      exponent: view.getInt16(2, true),
      step: view.getFloat32(4, true),
      planes: view.getUint16(8, true),
      transfer: view.getUint8(10) & ~14, // the bits say how tables are coded, which nobody here reads
      tables: view.getUint32(11, true),
    };
    demand(bytes[0] === 4, "not body 4 of klt");
    demand(bytes[1] === LEVELS && Math.abs(head.exponent) <= 150 && head.transfer < 2, "a head that no encoder writes");
    demand(head.step >= 2 ** -22 && head.step <= 8, "a step that no encoder writes");
    demand(head.planes <= channels * coefficients && head.tables >= channels * channels + head.planes, "too many planes");
    return head;
  }

  /** Where the streams begin and end, and their checksums; null where the front holds not all of the index. */
  function parseIndex(front, head, count) {
    let at = HEAD_SIZE + head.tables;
    const starts = new Float64Array(count + 1);
    const sums = new Uint16Array(count);
    let total = 0;
    for (let i = 0; i < count; i++) {
      let size = 0;
      for (let shift = 0; ; shift += 7) {
        demand(shift <= 28, "a length in the index has too many bytes");
        if (at + 3 > front.length) return null;
        const byte = front[at++];
        size += (byte & 127) * 2 ** shift;
        if (byte < 128) break;
      }
      sums[i] = front[at] | (front[at + 1] << 8);
      at += 2;
      starts[i] = total;
      total += size;
    }
    if (at + 2 > front.length) return null;
    starts[count] = total;
    demand((front[at] | (front[at + 1] << 8)) === crc16(front.subarray(0, at)), "the checksum of the index does not fit");
    at += 2;
    for (let i = 0; i <= count; i++) starts[i] += at;
    return { starts, sums };
  }

  /** The bytes of a body without the zeros of the least size; see "Least size". `tail` is its last four bytes. */
  function lengthWithoutPadding(length, tail, shape) {
    const beyond = shape.reduce((product, side) => product * side, 1) - 2 ** 24;
    if (beyond <= 0) return length;
    const least = Math.max(4, Math.ceil(beyond / 2 ** 17));
    demand(length >= least, "a body is shorter than its least size");
    const zeros = new DataView(tail.buffer, tail.byteOffset, 4).getUint32(0, true);
    const end = length - 4 - zeros;
    demand(end >= 0 && (!zeros || length === least), "padding that no encoder writes");
    return end;
  }

  /** Units of a body, decoded as they are asked for and kept while there is room. */
  class Units {
    /**
     * shape: [K, H, W, C]; front: bytes up to the first stream and no less; length: of the body without padding;
     * read(begin, end): a promise of bytes; start: the tables that streams begin with.
     */
    constructor(shape, front, length, read, start, roomBytes = 1 << 28) {
      const [coefficients, height, width, channels] = shape;
      demand(height >= 1 && width >= 1 && height * width <= MOST_PIXELS && channels >= 1, "a shape that nothing has");
      Object.assign(this, { height, width, read, start, roomBytes });
      this.head = parseHead(front, channels, coefficients);
      this.planes = this.head.planes;
      demand(this.planes * 3 * 64 * 64 <= MOST_VALUES, "more planes than a page can hold");
      this.together = height * width <= TOGETHER;
      Object.assign(this, layOut(height, width));
      const streams = this.planes === 0 ? 0 : this.together ? 1 : this.count;
      // A stream takes three bytes of the index at least: few bytes cannot claim many.
      demand(3 * streams <= length, "a body is shorter than its index");
      this.index = parseIndex(front, this.head, streams);
      demand(this.index, "a body is cut short within its index");
      demand(this.index.starts[streams] === length, "a body has another length than its streams");
      this.kept = new Map();
      this.keptBytes = 0;
    }

    /** {level, row, column, rows, columns} of bands of a unit; null for those without samples in it. */
    place(number) {
      const level = [1, 2, 3, 4, 5, 0].find((each) => number >= this.grids[each].first);
      const grid = this.grids[level];
      const row = Math.floor((number - grid.first) / grid.columns) * grid.side;
      const column = ((number - grid.first) % grid.columns) * grid.side;
      const shapes = level ? bandShapes(this.height, this.width, level) : [{ height: grid.h, width: grid.w }];
      const bands = shapes.map((shape) => {
        if (shape.height <= row || shape.width <= column) return null;
        return { rows: Math.min(grid.side, shape.height - row), columns: Math.min(grid.side, shape.width - column) };
      });
      return { level, row, column, bands };
    }

    /** Number of the unit of a level that holds a sample of its subbands. */
    numberOf(level, row, column) {
      const { side, first, columns } = this.grids[level];
      return first + Math.floor(row / side) * columns + Math.floor(column / side);
    }

    parentNumber({ level, row, column }) {
      return level > 0 && level < LEVELS ? this.numberOf(level + 1, row >> 1, column >> 1) : -1;
    }

    /** Make sure that units are decoded; those above them first, all bytes in few requests. */
    async need(numbers) {
      if (!this.planes) return;
      const wanted = new Set();
      const add = (number) => {
        if (number < 0 || wanted.has(number)) return;
        add(this.parentNumber(this.place(number)));
        wanted.add(number);
      };
      for (const number of numbers) add(number);
      if (this.together) {
        if (!this.kept.size) this.decodeAll(await this.fetchStream(0));
        return;
      }
      const missing = [...wanted].filter((number) => !this.kept.has(number));
      for (const number of wanted) this.touch(number);
      const parts = await this.fetchStreams(missing);
      missing.forEach((number, i) => this.decodeAlone(number, parts[i]));
    }

    touch(number) {
      const unit = this.kept.get(number);
      if (!unit) return;
      this.kept.delete(number);
      this.kept.set(number, unit);
    }

    async fetchStream(number) {
      const { starts } = this.index;
      return this.checked(number, await this.read(starts[number], starts[number + 1]));
    }

    checked(number, bytes) {
      const { starts, sums } = this.index;
      demand(bytes.length === starts[number + 1] - starts[number], "a stream is cut short");
      demand(crc16(bytes) === sums[number], `the checksum of unit ${number} does not fit`);
      return bytes;
    }

    async fetchStreams(numbers) {
      const { starts } = this.index;
      const found = [];
      const sorted = numbers.map((number, i) => [number, i]).sort((a, b) => a[0] - b[0]);
      for (let i = 0; i < sorted.length; ) {
        let j = i;
        while (j + 1 < sorted.length && starts[sorted[j + 1][0]] - starts[sorted[j][0] + 1] < 1 << 15) j++;
        const begin = starts[sorted[i][0]];
        found.push([i, j, begin, this.read(begin, starts[sorted[j][0] + 1])]);
        i = j + 1;
      }
      const parts = new Array(numbers.length);
      for (const [i, j, begin, promise] of found) {
        const bytes = await promise;
        for (let s = i; s <= j; s++) {
          const [number, place] = sorted[s];
          parts[place] = this.checked(number, bytes.subarray(starts[number] - begin, starts[number + 1] - begin));
        }
      }
      return parts;
    }

    decodeAlone(number, bytes) {
      const stream = new Stream(bytes);
      this.decodeUnit(number, stream, new Tables(this.start));
      stream.finish();
    }

    decodeAll(bytes) {
      const [stream, tables] = [new Stream(bytes), new Tables(this.start)];
      for (let number = 0; number < this.count; number++) this.decodeUnit(number, stream, tables);
      stream.finish();
    }

    decodeUnit(number, stream, tables) {
      const place = this.place(number);
      let bands;
      if (place.level === 0) {
        const [{ rows, columns }] = place.bands;
        const live = new Uint8Array(this.planes).fill(1);
        bands = [{ values: decodeLow(stream, tables, this.planes, rows, columns), live }];
      } else bands = decodeDetails(stream, tables, this.planes, place.bands, this.parentsOf(place));
      this.keep(number, bands.map((band) => band && { ...band, values: narrowed(band.values) }));
    }

    parentsOf(place) {
      const above = this.parentNumber(place);
      if (above < 0) return [null, null, null];
      const parent = this.place(above);
      const kept = this.kept.get(above).bands;
      const top = (place.row >> 1) - parent.row;
      const left = (place.column >> 1) - parent.column;
      return parent.bands.map((band, b) => {
        if (!band || band.rows <= top || band.columns <= left) return null;
        return { ...kept[b], rows: band.rows, columns: band.columns, top, left };
      });
    }

    keep(number, bands) {
      const bytes = bands.reduce((sum, band) => sum + (band ? band.values.byteLength : 0), 0);
      this.kept.set(number, { bands, bytes });
      this.keptBytes += bytes;
    }

    /** Forget those that were not asked for lately; between requests, so that none goes that is needed. */
    makeRoom() {
      if (this.together) return;
      for (const [number, unit] of this.kept) {
        if (this.keptBytes <= this.roomBytes) break;
        this.kept.delete(number);
        this.keptBytes -= unit.bytes;
      }
    }
  }

  /** Integers in 16 bits where they fit. */
  function narrowed(values) {
    for (let i = 0; i < values.length; i++) if (values[i] !== (values[i] << 16) >> 16) return values;
    return Int16Array.from(values);
  }

  Object.assign(clrelight, { Units, bandShapes, halved, lengthWithoutPadding, parseHead, LEVELS, HEAD_SIZE });
})();
