// Draws tiles into linear radiance, one picture for each file that is shown, and those onto the screen.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { compile, VERTEX, show, planeSum, tilesOf, weightsOf, TILE, ROOM } = clrelight;

  const MOST_VECTORS = 216; // of uniforms in a program: more take long to compile
  const KEPT_VECTORS = 8; // for other uniforms, and what a driver adds

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
      this.sums = 0; // pictures that were made
      }

    sumProgram(layers, nodes, bent) {
      const key = `${layers}/${nodes}/${bent}`;
      if (!this.programs.has(key)) this.programs.set(key, compile(this.gl, VERTEX, planeSum(layers, nodes, bent)));
      return this.programs.get(key);
    }

    /**
     * What is drawn of each tile, one after another and added up: {program, weights(levels), layer}.
     *
     * As many nodes at once as a program has uniforms for; of planes without a curve, as many layers.
     */
    planPasses(file, { bent, nodes }) {
      const { gl } = this;
      const vectors = Math.min(gl.getParameter(gl.MAX_FRAGMENT_UNIFORM_VECTORS) - KEPT_VECTORS, MOST_VECTORS);
      const mostLayers = Math.floor((vectors - 2) / 3);
      const cuts = bent ? 1 : Math.max(Math.ceil(file.layers / mostLayers), 1);
      const layers = Math.ceil(file.layers / cuts);
      if (layers > gl.getParameter(gl.MAX_FRAGMENT_UNIFORM_VECTORS) / 3 - 4) throw new Error("it has too many planes for this graphics card");
      const atOnce = Math.min(Math.max(Math.floor(vectors / (3 * layers + 2)), 1), nodes.length);
      const program = this.sumProgram(layers, atOnce, bent);
      const passes = [];
      for (let first = 0; first < nodes.length; first += atOnce)
        for (let cut = 0; cut < cuts; cut++) {
          const some = nodes.slice(first, first + atOnce);
          const weights = (levels) => packNodes(file, some, levels, layers, cut * layers, atOnce);
          passes.push({ program, weights, layer: cut * layers });
        }
      return passes;
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

    /** Sums of planes at a pixel, so to speak: what a picture of a size costs is in proportion. */
    work(file, lighting, state) {
      return file.layers * (file.bent ? weightsOf(lighting, state, file).nodes.length : 1);
    }

    /** The level that is drawn: that of the screen, or a coarser one of coefficients for which the card has no room. */
    levelOf(file, view) {
      let level = view.levelFor(file.levels);
      const bytes = 8 * file.layers * TILE ** 2;
      const isLarge = () => tilesOf(file, level, view.seen).length * bytes > ROOM / 2;
      while (file.payload !== undefined && view.seen && level < file.levels && isLarge()) level++;
      return level;
    }

    /** Whether there is something of each part of a file that is seen; what is missing is asked for. */
    covers(file, view, store) {
      const level = this.levelOf(file, view);
      const places = view.seen ? tilesOf(file, level, view.seen) : [];
      return places.map((at) => this.tileFor(file, level, ...at, store, 0)).every(Boolean);
    }

    /** Wait until all is drawn. */
    finish() {
      const { gl } = this;
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.pictures[0].frame);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, new Float32Array(4));
    }

    /**
     * Draw what is seen of a file; return whether all of it was there at the level it should be.
     *
     * A picture that is there already stays: exposure, curves and comparisons are no part of it.
     */
    sum(slot, file, view, store, lighting, state, scale) {
      const width = Math.max(Math.round(view.width * scale), 1);
      const height = Math.max(Math.round(view.height * scale), 1);
      const picture = this.picture(slot, width, height);
      const level = this.levelOf(file, view);
      const places = view.seen ? tilesOf(file, level, view.seen) : [];
      const found = places.map((at) => this.tileFor(file, level, ...at, store, state.photograph));
      const { light, lamp, sky, environment, standing } = state;
      const key = JSON.stringify([
        ...[file.id, view.x, view.y, view.zoom, light, lamp, sky, environment, standing],
        found.map((each) => each && [each.tile.serial, each.part]),
      ]);
      if (picture.key !== key) this.drawSum(picture, file, view, found, weightsOf(lighting, state, file), scale < 1);
      picture.key = key;
      return found.every((each) => each?.tile.level === level);
    }

    drawSum({ frame, width, height }, file, view, found, weights, fast) {
      const { gl } = this;
      this.sums++;
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.viewport(0, 0, width, height);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT);
      if (!found.length) return;
      gl.blendFunc(gl.ONE, gl.ONE);
      this.planPasses(file, weights).forEach((pass, i) => {
        if (i === 1) gl.enable(gl.BLEND);
        this.drawPass(pass, view, found.filter(Boolean), i === 0, fast);
      });
      gl.disable(gl.BLEND);
    }

    drawPass({ program, weights, layer }, view, found, isFirst, fast) {
      const { gl } = this;
      gl.useProgram(program.program);
      gl.uniform1i(program.uniforms.uPlanes, 0);
      gl.uniform1f(program.uniforms.uLayer, layer);
      gl.uniform1f(program.uniforms.uAlpha, isFirst ? 1 : 0);
      let sent;
      for (const each of found) {
        if (sent !== each.tile.levels) gl.uniform4fv(program.uniforms.uWeights, weights(each.tile.levels));
        sent = each.tile.levels;
        this.drawTile(program, view, each, fast);
      }
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

  /**
   * Weights of nodes as vectors, of `layers` from one on; what is left of `count` nodes is 0.
   *
   * Planes are `low + step * byte` where levels are given; what is 1 everywhere goes with the first layers.
   */
  function packNodes(file, nodes, levels, layers, firstLayer, count) {
    const width = file.planes + 1;
    const rows = 3 * layers + 2;
    const packed = new Float32Array(4 * rows * count);
    nodes.forEach(({ weights, share }, n) => {
      const at = 4 * rows * n;
      const last = Math.min(4 * (firstLayer + layers), file.planes);
      for (let c = 0; c < 3; c++) {
        let constant = firstLayer ? 0 : weights[c * width + file.planes];
        for (let p = 4 * firstLayer; p < last; p++) {
          const weight = weights[c * width + p];
          packed[at + 4 * (3 * ((p >> 2) - firstLayer) + c) + (p & 3)] = levels ? 255 * levels.step[p] * weight : weight;
          if (levels) constant += levels.low[p] * weight;
        }
        packed[at + 12 * layers + c] = constant;
      }
      packed.set(share, at + 12 * layers + 4);
    });
    return packed;
  }

  Object.assign(clrelight, { Renderer });
})();
