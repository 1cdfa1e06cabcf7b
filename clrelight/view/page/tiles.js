// Tiles of all files: asked for as the view needs them, decoded by workers or fetched, kept on the graphics card.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { TILE, tilePlace, halved, floatsOf, fromBase64, evaluationOf, productRule, spreadOverAzimuths } = clrelight;

  const ROOM = 768 * 2 ** 20; // bytes of textures
  const MOST_AT_ONCE = 4; // requests to the server

  /** Makes workers of the scripts that the page carries for them. */
  function makeWorkers(count) {
    const parts = [...document.querySelectorAll("script[data-worker]")].map((each) => each.textContent);
    const address = URL.createObjectURL(new Blob(parts, { type: "text/javascript" }));
    return Array.from({ length: count }, () => new Worker(address));
  }

  /** Content that a page on disk carries with it. */
  function embedded(name) {
    const element = document.getElementById(`data-${name}`);
    return element && fromBase64(element.textContent.trim());
  }

  /** A file of the manifest with its numbers as arrays. */
  function openFile(facts, id) {
    const file = { ...facts, id, layers: Math.ceil(facts.planes / 4) };
    for (const name of ["operator", "directions"]) if (facts[name]) file[name] = floatsOf(facts[name]);
    if (file.kind === "photographs") [file.planes, file.layers] = [file.channels, 1];
    if (file.bent) {
      file.nodes = productRule(file.degree).directions;
      file.columns = floatsOf(facts.analysis);
      file.analysis = spreadOverAzimuths(file.columns, file.degree);
      file.straight = straightFile(file);
    }
    return file;
  }

  /** A file behind the curve as one of coefficients, which workers make of its tiles. */
  function straightFile(file) {
    const planes = file.shape[0] * file.channels;
    const own = { id: `${file.id}-straight`, payload: file.id, planes, layers: Math.ceil(planes / 4) };
    return { ...file, ...own, bent: false, operator: null };
  }

  class TileStore {
    constructor(gl, manifest, changed) {
      Object.assign(this, { gl, manifest, changed });
      this.files = manifest.files.map(openFile);
      this.tiles = new Map();
      this.bytes = 0;
      this.frame = 0;
      this.pending = new Map();
      this.wanted = [];
      this.fetching = 0;
      this.jobs = 0;
      this.settled = 0;
      this.faults = [];
      this.startWorkers();
    }

    startWorkers() {
      const payloads = this.files.filter((file) => file.kind === "klt");
      if (!payloads.length) return;
      const cores = navigator.hardwareConcurrency || 2;
      this.workers = makeWorkers(Math.min(Math.max(cores - 1, 2), 6)).map((worker) => ({ worker, busy: 0, curves: new Set() }));
      const start = fromBase64(this.manifest.start);
      for (const file of payloads) {
        const bytes = embedded(`body-${file.id}`);
        const blob = bytes && new Blob([bytes]);
        const address = new URL(`body/${file.id}`, location.href).href;
        const scales = floatsOf(file.units);
        const { id, shape, length, front } = file;
        const told = { type: "open", id, shape, length, front, scales, start, blob, address };
        for (const { worker } of this.workers) worker.postMessage(told);
      }
      for (const each of this.workers) each.worker.onmessage = ({ data }) => this.take(each, data);
    }

    key(file, level, row, column, light) {
      return `${file.id}/${level}/${row}/${column}/${file.kind === "photographs" ? light : 0}`;
    }

    /** A tile that is on the card; null, and wanted from now on, where it is not. */
    find(file, level, row, column, light, want) {
      const key = this.key(file, level, row, column, light);
      const tile = this.tiles.get(key);
      if (tile) {
        tile.used = this.frame;
        return tile.texture ? tile : null;
      }
      if (want && !this.pending.has(key)) this.wanted.push({ key, file, level, row, column, light });
      return null;
    }

    /** Begin a frame: what is wanted is said anew. */
    beginFrame() {
      this.frame++;
      this.wanted = [];
    }

    /** End a frame: ask for what is wanted, the coarsest first. */
    endFrame() {
      const seen = new Set();
      this.wanted = this.wanted.filter(({ key }) => !seen.has(key) && seen.add(key));
      this.wanted.sort((a, b) => b.level - a.level);
      this.ask();
      this.makeRoom();
    }

    get isIdle() {
      return !this.wanted.length && !this.pending.size;
    }

    ask() {
      const left = [];
      for (const each of this.wanted) {
        if (this.pending.has(each.key)) continue;
        const sent = each.file.kind === "klt" ? this.askWorker(each) : this.askServer(each);
        if (!sent) left.push(each);
      }
      this.wanted = left;
    }

    askWorker(wanted) {
      // Tiles that lie together hang on the same units: the same worker has them.
      const { file, level, row, column } = wanted;
      const own = this.workers[((row >> 1) * 31 + (column >> 1)) % this.workers.length];
      const worker = own.busy < 2 ? own : this.workers.find((each) => each.busy === 0);
      if (!worker) return false;
      const job = ++this.jobs;
      worker.busy++;
      const straight = "payload" in file;
      if (straight) this.tellCurve(worker, this.files[file.payload]);
      worker.worker.postMessage({ type: "tile", id: straight ? file.payload : file.id, job, level, row, column, straight });
      this.pending.set(wanted.key, { ...wanted, job });
      return true;
    }

    /** What a worker makes coefficients with, once: of large degrees it takes a moment. */
    tellCurve(worker, file) {
      const { id, planes, channels, columns, degree } = file;
      file.curve ??= { planes, channels, columns, degree, evaluation: evaluationOf(file) };
      if (!worker.curves.has(id)) worker.worker.postMessage({ type: "curve", id, curve: file.curve });
      worker.curves.add(id);
    }

    take(worker, { job, texels, error }) {
      worker.busy--;
      const entry = [...this.pending.values()].find((each) => each.job === job);
      if (entry) this.settle(entry, texels && { texels, levels: null }, error);
    }

    askServer(wanted) {
      if (this.fetching >= MOST_AT_ONCE) return false;
      this.fetching++;
      this.pending.set(wanted.key, wanted);
      this.fetchTile(wanted)
        .then((content) => this.settle(wanted, content))
        .catch((error) => this.settle(wanted, null, String(error.message ?? error)))
        .finally(() => {
          this.fetching--;
          this.ask();
        });
      return true;
    }

    async fetchTile({ file, level, row, column, light }) {
      let bytes = embedded(`tile-${file.id}-${level}-${row}-${column}-${file.kind === "photographs" ? light : 0}`);
      if (!bytes) {
        if (this.manifest.on_disk) throw new Error("the page does not carry this part");
        const number = file.kind === "photographs" ? light : 0;
        const answer = await fetch(`tile/${file.id}/${level}/${row}/${column}/${number}`);
        if (!answer.ok) throw new Error(`the server says ${answer.status}: does it still run?`);
        bytes = new Uint8Array(await answer.arrayBuffer());
      }
      if (this.manifest.planes === "half" || file.kind === "photographs") {
        return { texels: new Uint16Array(bytes.buffer, 0, bytes.length >> 1), levels: null };
      }
      const head = 4 * file.layers;
      const numbers = new Float32Array(bytes.buffer, 0, 2 * head);
      return { texels: bytes.subarray(8 * head), levels: { low: numbers.slice(0, head), step: numbers.slice(head) } };
    }

    settle(entry, content, error) {
      this.pending.delete(entry.key);
      const tile = { serial: ++this.settled, used: this.frame, texture: null, bytes: 0, levels: null };
      if (content) {
        const { file, level, row, column } = entry;
        const place = tilePlace(file.height, file.width, level, row, column);
        Object.assign(tile, { level, place, levels: content.levels, bytes: content.texels.byteLength });
        const size = 4 * file.layers * (place.bottom - place.top) * (place.right - place.left);
        if (content.texels.length === size) tile.texture = this.upload(file, place, content.texels);
        else error = "a tile has another size than it should";
      }
      if (error) this.faults.push(`${entry.file.name}: ${error}`);
      this.tiles.set(entry.key, tile);
      this.bytes += tile.bytes;
      this.ask();
      this.changed();
    }

    upload(file, place, texels) {
      const { gl } = this;
      const texture = gl.createTexture();
      const half = texels instanceof Uint16Array;
      const [width, height] = [place.right - place.left, place.bottom - place.top];
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
      for (const axis of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, axis, gl.CLAMP_TO_EDGE);
      gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
      const [inner, type] = half ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
      if (file.layers) gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, inner, width, height, file.layers, 0, gl.RGBA, type, texels);
      return texture;
    }

    makeRoom() {
      if (this.bytes <= ROOM) return;
      const old = [...this.tiles].filter(([, tile]) => tile.used < this.frame).sort((a, b) => a[1].used - b[1].used);
      for (const [key, tile] of old) {
        if (this.bytes <= 0.8 * ROOM) break;
        if (tile.texture) this.gl.deleteTexture(tile.texture);
        this.bytes -= tile.bytes;
        this.tiles.delete(key);
      }
    }

    /** Forget all textures, of a context that was lost, and those that failed. */
    forget() {
      this.tiles.clear();
      this.bytes = 0;
      this.faults = [];
    }
  }

  /** Rows and columns of the tiles of a level that a part of the image, in its pixels, touches. */
  function tilesOf(file, level, [left, top, right, bottom]) {
    const [h, w] = [halved(file.height, level), halved(file.width, level)];
    const span = (low, high, side) => {
      const first = Math.max(Math.floor(low / 2 ** level / TILE), 0);
      return [first, Math.min(Math.floor(high / 2 ** level / TILE), Math.ceil(side / TILE) - 1)];
    };
    const [firstRow, lastRow] = span(top, bottom, h);
    const [firstColumn, lastColumn] = span(left, right, w);
    const found = [];
    for (let row = firstRow; row <= lastRow; row++)
      for (let column = firstColumn; column <= lastColumn; column++) found.push([row, column]);
    return found;
  }

  Object.assign(clrelight, { TileStore, tilesOf, ROOM });
})();
