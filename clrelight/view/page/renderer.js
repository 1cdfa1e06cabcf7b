// Draws tiles into linear radiance, one picture for each file that is shown, and those onto the screen.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { compile, VERTEX, show, linearSum, nodeSum, tilesOf, weightsOf, TILE, halved } = clrelight;

  const MOST_UNIFORM_LAYERS = 60; // 181 of the 224 vectors that every WebGL 2 has

  class Renderer {
    constructor(canvas) {
      this.canvas = canvas;
      const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });
      if (!gl) throw new Error("this browser has no WebGL 2, which the viewer needs");
      if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) {
        throw new Error("this graphics card cannot draw into floats, which the viewer needs");
      }
      this.gl = gl;
      this.restart();
    }

    /** Make everything anew, at first and when a context comes back. */
    restart() {
      this.programs = new Map();
      this.pictures = [];
      this.table = null;
    }

    sumProgram(file, bent) {
      const uniform = !bent && file.layers <= MOST_UNIFORM_LAYERS;
      const key = `${file.layers}/${bent}`;
      if (!this.programs.has(key)) {
        const text = uniform ? linearSum(file.layers) : nodeSum(file.layers, bent);
        this.programs.set(key, { ...compile(this.gl, VERTEX, text), uniform });
      }
      return this.programs.get(key);
    }

    showProgram(compare, curve) {
      const key = `${compare}/${curve}`;
      if (!this.programs.has(key)) this.programs.set(key, compile(this.gl, VERTEX, show(compare, curve)));
      return this.programs.get(key);
    }

    /** A picture of linear radiance of a size, that of a place in the comparison. */
    picture(slot, width, height) {
      const { gl } = this;
      const old = this.pictures[slot];
      if (old && old.width === width && old.height === height) return old;
      if (old) gl.deleteTexture(old.texture);
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
      for (const axis of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, axis, gl.CLAMP_TO_EDGE);
      for (const way of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, way, gl.NEAREST);
      const frame = old ? old.frame : gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      return (this.pictures[slot] = { texture, frame, width, height });
    }

    /** Draw what is seen of a file; return whether all of it was there at the level it should be. */
    sum(slot, file, view, store, lighting, state, scale) {
      const { gl } = this;
      const width = Math.max(Math.round(view.width * scale), 1);
      const height = Math.max(Math.round(view.height * scale), 1);
      const picture = this.picture(slot, width, height);
      gl.bindFramebuffer(gl.FRAMEBUFFER, picture.frame);
      gl.viewport(0, 0, width, height);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT);
      if (!view.seen) return true;
      const { bent, nodes } = weightsOf(lighting, state, file);
      const program = this.sumProgram(file, bent);
      gl.useProgram(program.program);
      gl.uniform1i(program.uniforms.uPlanes, 0);
      this.sentLevels = undefined;
      const level = view.levelFor(file.levels);
      let whole = true;
      for (const [row, column] of tilesOf(file, level, view.seen)) {
        const found = this.tileFor(file, level, row, column, store, state.photograph);
        whole = whole && found?.tile.level === level;
        if (!found) continue;
        this.sendWeights(program, file, nodes, found.tile.levels);
        this.drawTile(program, view, found, scale < 1);
      }
      return whole;
    }

    /** The tile, or the part of a coarser one that is there; what is missing is asked for. */
    tileFor(file, level, row, column, store, light) {
      const side = TILE * 2 ** level;
      const part = [column * side, row * side, Math.min((column + 1) * side, file.width), Math.min((row + 1) * side, file.height)];
      let found = null;
      for (let coarse = level; coarse <= file.levels; coarse++) {
        const shift = coarse - level;
        const wanted = coarse === level || (coarse === file.levels && !found);
        const tile = store.find(file, coarse, row >> shift, column >> shift, light, wanted);
        if (tile && !found) found = { tile, part };
        if (found && coarse === level) break;
      }
      return found;
    }

    sendWeights(program, file, nodes, levels) {
      if (this.sentLevels === levels) return;
      this.sentLevels = levels;
      const { gl } = this;
      const rows = nodes.map(({ weights }) => packWeights(file, weights, levels));
      if (program.uniform) {
        gl.uniform4fv(program.uniforms.uWeights, rows[0]);
        return;
      }
      const width = 3 * file.layers + 2;
      const table = new Float32Array(4 * width * nodes.length);
      nodes.forEach(({ share }, n) => {
        table.set(rows[n], 4 * width * n);
        table.set(share, 4 * (width * n + width - 1));
      });
      this.table ??= gl.createTexture();
      gl.activeTexture(gl.TEXTURE1);
      gl.bindTexture(gl.TEXTURE_2D, this.table);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, nodes.length, 0, gl.RGBA, gl.FLOAT, table);
      for (const way of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, way, gl.NEAREST);
      gl.uniform1i(program.uniforms.uTable, 1);
      gl.uniform1i(program.uniforms.uNodes, nodes.length);
      gl.activeTexture(gl.TEXTURE0);
    }

    drawTile(program, view, { tile, part }, fast) {
      const { gl } = this;
      const { level, place } = tile;
      const scale = 2 ** level;
      const [width, height] = [place.right - place.left, place.bottom - place.top];
      const u = (x) => (x / scale - place.left) / width;
      const v = (y) => (y / scale - place.top) / height;
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, tile.texture);
      this.filter(tile, fast ? gl.NEAREST : gl.LINEAR);
      gl.uniform4fv(program.uniforms.uPlace, view.toClip(part));
      gl.uniform4f(program.uniforms.uTexture, u(part[0]), v(part[3]), u(part[2]), v(part[1]));
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }

    /** Between texels, where there is time for it: without a graphics card it takes most of a frame. */
    filter(tile, way) {
      const { gl } = this;
      if (tile.filter === way) return;
      tile.filter = way;
      for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, way);
    }

    /** Show pictures: the first, both with a line between them, or their difference. */
    present(state) {
      const { gl, canvas } = this;
      const { width, height } = this.pictures[0];
      if (canvas.width !== width) canvas.width = width;
      if (canvas.height !== height) canvas.height = height;
      const { program, uniforms } = this.showProgram(state.compare, state.curve);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      gl.viewport(0, 0, width, height);
      gl.useProgram(program);
      const second = this.pictures[1] ?? this.pictures[0];
      [this.pictures[0], second].forEach(({ texture }, unit) => {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, texture);
      });
      gl.uniform1i(uniforms.uFirst, 0);
      gl.uniform1i(uniforms.uSecond, 1);
      gl.uniform1f(uniforms.uGain, 2 ** state.exposure);
      gl.uniform1f(uniforms.uErrorGain, state.errorGain);
      gl.uniform1f(uniforms.uSplit, state.split);
      gl.uniform1f(uniforms.uWidth, width);
      gl.uniform4f(uniforms.uPlace, -1, -1, 1, 1);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      gl.activeTexture(gl.TEXTURE0);
    }

    /** Linear radiance of a picture, rgba by rows from the bottom: alpha is 1 where there is one. */
    read(slot) {
      const { gl } = this;
      const { frame, width, height } = this.pictures[slot];
      const values = new Float32Array(4 * width * height);
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, values);
      return { values, width, height };
    }
  }

  /** Weights [channel][plane, and 1] as vectors, for planes that are `low + step * byte` where levels are given. */
  function packWeights(file, weights, levels) {
    const width = file.planes + 1;
    const packed = new Float32Array(4 * (3 * file.layers + 1));
    for (let c = 0; c < 3; c++) {
      let constant = weights[c * width + file.planes];
      for (let p = 0; p < file.planes; p++) {
        const weight = weights[c * width + p];
        packed[4 * (3 * (p >> 2) + c) + (p & 3)] = levels ? 255 * levels.step[p] * weight : weight;
        if (levels) constant += levels.low[p] * weight;
      }
      packed[12 * file.layers + c] = constant;
    }
    return packed;
  }

  Object.assign(clrelight, { Renderer });
})();
