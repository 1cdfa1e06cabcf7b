// Decodes tiles of klt payloads beside the page: of it, and of the decoder, workers are made.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { Units, decodeRegion, straighten, demand, halved } = clrelight;

  const TILE = 256;
  const BORDER = 1;

  /** Pixels of a tile of a level, a border with them that neighbours share. */
  function tilePlace(height, width, level, row, column) {
    const [h, w] = [halved(height, level), halved(width, level)];
    return {
      top: Math.max(row * TILE - BORDER, 0),
      left: Math.max(column * TILE - BORDER, 0),
      bottom: Math.min((row + 1) * TILE + BORDER, h),
      right: Math.min((column + 1) * TILE + BORDER, w),
    };
  }

  /** What reads bytes of a body: of a server, or of a blob in the page. */
  function readerOf({ address, blob, length }) {
    return async (begin, end) => {
      demand(0 <= begin && begin <= end && end <= length, "bytes beyond the body");
      if (blob) return new Uint8Array(await blob.slice(begin, end).arrayBuffer());
      const answer = await fetch(`${address}/${begin}-${end}`);
      if (!answer.ok) throw new Error(`the server says ${answer.status}: does it still run?`);
      return new Uint8Array(await answer.arrayBuffer());
    };
  }

  const opened = new Map();

  async function decode({ id, job, level, row, column, straight }) {
    try {
      const { units: promise, scales, curve } = opened.get(id);
      const units = await promise;
      const { top, left, bottom, right } = tilePlace(units.height, units.width, level, row, column);
      const planes = await decodeRegion(units, level, top, left, bottom, right, scales);
      const texels = straight ? straighten(planes, (bottom - top) * (right - left), curve) : planes;
      postMessage({ job, texels }, [texels.buffer]);
    } catch (error) {
      postMessage({ job, error: String(error.message ?? error) });
    }
  }

  function start() {
    let last = Promise.resolve();
    onmessage = ({ data }) => {
      if (data.type === "open") {
        const read = readerOf(data);
        const units = read(0, data.front).then((front) => new Units(data.shape, front, data.length, read, data.start));
        units.catch(() => {}); // told with each tile
        opened.set(data.id, { units, scales: data.scales });
      } else if (data.type === "curve") opened.get(data.id).curve = data.curve;
      else last = last.then(() => decode(data)); // one at a time: what is decoded is shared
    };
  }

  if (typeof WorkerGlobalScope !== "undefined" && globalThis instanceof WorkerGlobalScope) start();

  Object.assign(clrelight, { TILE, BORDER, tilePlace });
})();
