// The viewer: its state, frames when something changes, and what controls do.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { Renderer, TileStore, Lighting, View, Panel, Globe, Pointers, RADIANS } = clrelight;
  const { decibelsApart, automaticExposure, directionOf, isOneDirection, START } = clrelight;

  const DRAGGED = 0.5; // of the resolution while something is dragged
  const COARSEST = 0.125;
  const PATIENCE = { dragged: 90, still: 1500 }; // milliseconds of a frame: coarser where it would take longer
  const HEAVY = 40; // sums at a pixel from which on nobody knows how long they take without having tried
  const FIGURES_AFTER = 180;

  class App {
    constructor(manifest) {
      this.manifest = manifest;
      this.canvas = document.getElementById("picture");
      const second = manifest.reference ?? Math.min(1, manifest.files.length - 1);
      this.state = { ...structuredClone(START), second, exposure: manifest.exposure ?? 0 };
      this.renderer = new Renderer(this.canvas);
      this.lighting = new Lighting(manifest);
      this.store = new TileStore(this.renderer.gl, manifest, () => this.changed());
      this.view = new View(manifest.files[0].width, manifest.files[0].height);
      this.dragging = false;
      this.coarser = 1; // times, of the level that is drawn
      this.pace = 0; // milliseconds of a million sums, once measured
      this.started = performance.now();
      this.panel = new Panel(this, manifest);
      this.globe = new Globe(document.getElementById("globe"), this);
      this.pointers = new Pointers(this.canvas, this);
      this.watch();
      this.resize();
    }

    watch() {
      new ResizeObserver(() => this.resize()).observe(this.canvas);
      this.watchRatio();
      this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
      this.canvas.addEventListener("webglcontextrestored", () => {
        this.store.forget();
        this.renderer.restart();
        this.changed();
      });
    }

    /** Another screen may have another number of pixels to a length. */
    watchRatio() {
      const watch = () => (this.resize(), this.watchRatio());
      matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", watch, { once: true });
    }

    resize() {
      this.ratio = Math.min(devicePixelRatio || 1, 2);
      const { clientWidth, clientHeight } = this.canvas;
      if (!clientWidth || !clientHeight) return;
      this.view.resize(Math.round(clientWidth * this.ratio), Math.round(clientHeight * this.ratio));
      this.changed();
    }

    /** Draw a frame soon; what is drawn now has no figures any more. */
    changed() {
      clearTimeout(this.figures);
      this.planned ??= requestAnimationFrame(() => {
        this.planned = null;
        this.frame();
      });
    }

    /** Files that the picture is made of. */
    shownFiles() {
      const { compare, first, second } = this.state;
      const numbers = compare === "one" ? [this.peeking ? second : first] : [first, second];
      return numbers.map((number) => this.store.files[number]);
    }

    /**
     * Files as they are drawn: behind a curve, where many directions take long, as coefficients as soon as these are there.
     *
     * Once that was so it stays so: tiles are there for the next light.
     */
    drawnFiles() {
      const { renderer, view, store, state } = this;
      const files = this.shownFiles();
      if (isOneDirection(state)) return files;
      const sums = (this.workOf(files) * this.view.width * this.view.height) / 1e6;
      this.isSlow ||= this.pace * sums > PATIENCE.dragged;
      if (!this.isSlow) return files;
      return files.map((file) => (file.straight && renderer.covers(file.straight, view, store) ? file.straight : file));
    }

    workOf(files) {
      return files.reduce((sum, file) => sum + this.renderer.work(file, this.lighting, this.state), 0);
    }

    frame() {
      const { store, renderer, view, lighting, state } = this;
      this.followPhotographs();
      store.beginFrame();
      const files = this.drawnFiles();
      const work = this.workOf(files);
      const scale = this.chooseScale(work);
      const since = performance.now();
      const { sums } = renderer;
      const whole = files.map((file, slot) => renderer.sum(slot, file, view, store, lighting, state, scale));
      this.coarser = Math.max(...files.map((file) => 2 ** (renderer.levelOf(file, view) - view.levelFor(file.levels))));
      if (files.length === 1) renderer.pictures.length = 1;
      const areNew = renderer.sums - sums === files.length;
      if (areNew && (this.dragging || work > HEAVY)) this.measurePace(work, scale, since);
      renderer.present(state);
      store.endFrame();
      this.isWhole = whole.every(Boolean);
      if (this.isWhole) this.firstPicture ??= performance.now() - this.started;
      if (this.isWhole && this.exposing) this.exposeAutomatically();
      if (store.tiles.size) this.someTiles ??= performance.now() - this.started;
      this.panel.update(state);
      this.panel.fault(store.faults.at(-1) ?? "");
      this.globe.draw(state, files[0]);
      this.planFigures();
    }

    /** The resolution at which a frame is soon there; half of the screen's at most while something is dragged. */
    chooseScale(work) {
      const { dragged, still } = PATIENCE;
      const sums = (work * this.view.width * this.view.height) / 1e6;
      let scale = this.dragging ? DRAGGED : 1;
      if (!this.pace && work > HEAVY) return (this.scale = COARSEST);
      while (scale > COARSEST && this.pace * sums * scale * scale > (this.dragging ? dragged : still)) scale /= 2;
      return (this.scale = scale);
    }

    measurePace(work, scale, since) {
      const isFirst = !this.pace;
      this.renderer.finish();
      const sums = (work * this.view.width * this.view.height * scale * scale) / 1e6;
      const pace = (performance.now() - since) / Math.max(sums, 1e-3);
      // Whatever is compiled, or waits for others, makes single frames long.
      this.pace = isFirst ? pace : Math.min(pace, 0.7 * this.pace + 0.3 * pace);
      if (scale < 1 && !this.dragging && (isFirst || this.chooseScale(work) > scale)) this.changed();
    }

    /** With photographs beside fits, the lamp is where one was taken: the nearest. */
    followPhotographs() {
      const stack = this.shownFiles().find((file) => file.kind === "photographs");
      if (!stack) return;
      const { state } = this;
      const [x, y, z] = state.lamp.direction;
      let best = -2;
      for (let i = 0; 3 * i < stack.directions.length; i++) {
        const [a, b, c] = stack.directions.subarray(3 * i, 3 * i + 3);
        const near = a * x + b * y + c * z;
        if (near > best) [best, state.photograph] = [near, i];
      }
      state.light = "lamp";
      state.lamp = { direction: [...stack.directions.subarray(3 * state.photograph, 3 * state.photograph + 3)], softness: 0 };
    }

    planFigures() {
      clearTimeout(this.figures);
      if (this.dragging) return;
      this.figures = setTimeout(() => this.showFigures(), FIGURES_AFTER);
    }

    showFigures() {
      const factor = this.coarser / this.scale;
      const coarse = factor > 1 ? ` · ${factor} × coarser pixels` : "";
      const zoom = `${Math.round(100 * this.view.zoom)} %${coarse}`;
      const { files } = this.manifest;
      const { compare, first, second } = this.state;
      if (compare === "one" || !this.store.isIdle || !this.isWhole) {
        this.panel.figure(this.store.isIdle ? zoom : `${zoom} · loading`);
        return;
      }
      const decibels = decibelsApart(this.renderer.read(0), this.renderer.read(1), files[first].transfer);
      const text = decibels === Infinity ? "identical" : `${decibels.toFixed(2)} dB`;
      const size = `${(files[first].bytes / files[second].bytes).toPrecision(3)} × its bytes`;
      this.panel.figure(Number.isNaN(decibels) ? zoom : `${text} from ${files[second].name} here, ${size} · ${zoom}`);
    }

    /** Set a part of the state, by a name or a path of names. */
    set(path, value) {
      const names = [path].flat();
      const last = names.pop();
      const place = names.reduce((part, name) => part[name], this.state);
      const limits = { exposure: [-8, 8] }[last];
      place[last] = limits ? Math.min(Math.max(value, limits[0]), limits[1]) : value;
      this.changed();
    }

    drag(dragging) {
      this.dragging = dragging;
      this.changed();
    }

    /** The lamp, the sun or the environment goes to where somebody points. */
    pointLight(direction) {
      const { state } = this;
      const [x, y, z] = direction;
      if (state.light === "lamp") state.lamp.direction = direction;
      else {
        const [a, b, c] = state.standing ? [x, -z, y] : direction;
        const azimuth = Math.round(Math.atan2(b, a) / RADIANS + 360) % 360;
        if (state.light === "environment") state.environment.turn = azimuth;
        else Object.assign(state.sky, { azimuth, height: Math.max(Math.round(Math.asin(c) / RADIANS), 0) });
      }
      this.changed();
    }

    nudgeLight(right, up) {
      const { state } = this;
      if (state.light === "environment") this.set(["environment", "turn"], (state.environment.turn + right + 360) % 360);
      else if (state.light === "sky") {
        this.set(["sky", "azimuth"], (state.sky.azimuth + right + 360) % 360);
        this.set(["sky", "height"], Math.min(Math.max(state.sky.height + up, 0), 90));
      } else {
        const [x, y] = state.lamp.direction;
        this.pointLight(directionOf(x + right * RADIANS, y + up * RADIANS));
      }
      this.panel.say(this.lightText());
    }

    lightText() {
      const { light, lamp, sky, environment } = this.state;
      if (light === "environment") return `Environment turned by ${environment.turn} degrees`;
      if (light === "sky") return `Sun ${sky.height} degrees high, azimuth ${sky.azimuth} degrees`;
      const [x, y, z] = lamp.direction;
      const azimuth = Math.round(Math.atan2(y, x) / RADIANS + 360) % 360;
      return `Lamp ${Math.round(Math.asin(z) / RADIANS)} degrees high, azimuth ${azimuth} degrees`;
    }

    zoom(factor, x, y) {
      this.view.zoomAt(factor, x, y);
      this.changed();
    }

    pan(right, down) {
      this.view.pan(right, down);
      this.changed();
    }

    fit() {
      this.view.fit();
      this.changed();
    }

    /** Show the other file while a key is down. */
    peek(on) {
      if (this.manifest.files.length < 2 || this.state.compare !== "one") return;
      this.peeking = on;
      this.changed();
    }

    nextCompare() {
      const ways = ["one", "split", "error"];
      if (this.manifest.files.length > 1) this.set("compare", ways[(ways.indexOf(this.state.compare) + 1) % 3]);
    }

    /** Make the brightest white, as soon as all of the picture is there. */
    exposeAutomatically() {
      this.exposing = !this.isWhole;
      if (this.exposing) return this.changed();
      this.set("exposure", Math.round(4 * automaticExposure(this.renderer.read(0))) / 4);
      this.panel.say(`Exposure ${this.state.exposure} stops`);
    }

    /** The command that makes this picture. */
    command() {
      const { light, lamp, exposure, first } = this.state;
      const { name } = this.manifest.files[first];
      const quoted = /^[\w./-]+$/.test(name) ? name : `'${name.replaceAll("'", "'\\''")}'`;
      const stops = exposure ? ` --exposure ${exposure}` : "";
      if (light !== "lamp" || this.store.files[first].kind === "photographs") return `clrelight view ${quoted}`;
      return `clrelight relight ${quoted} relit.png --light ${lamp.direction.map((v) => v.toFixed(3)).join(",")}${stops}`;
    }

    save() {
      this.frame();
      this.canvas.toBlob((blob) => {
        const link = document.createElement("a");
        link.href = URL.createObjectURL(blob);
        link.download = `${this.manifest.files[this.state.first].name.replace(/\.\w+$/, "")}.png`;
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 1000);
      });
    }
  }

  function start() {
    const manifest = JSON.parse(document.getElementById("manifest").textContent);
    try {
      clrelight.app = new App(manifest);
    } catch (error) {
      const fault = document.getElementById("fault");
      fault.hidden = false;
      fault.textContent = `The viewer cannot start: ${error.message}.`;
    }
  }

  start();
})();
