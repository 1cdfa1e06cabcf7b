// Mouse, touch, pen and keys on the picture: light, pan and zoom.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { directionOf } = clrelight;

  const STEP = 3; // degrees of a key
  const STILL = 12; // pixels of the screen within which a finger waits for another
  const lightOf = ({ lamp, sky, environment }) => structuredClone({ lamp, sky, environment });

  class Pointers {
    constructor(canvas, app) {
      Object.assign(this, { canvas, app, down: new Map(), panning: false, presses: [] });
      canvas.addEventListener("pointerdown", (event) => this.begin(event));
      canvas.addEventListener("pointermove", (event) => this.move(event));
      for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.end(event));
      canvas.addEventListener("contextmenu", (event) => event.preventDefault());
      canvas.addEventListener("dblclick", () => {
        this.takeBack(this.presses[0]);
        app.fit();
      });
      canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
      const hears = ({ target }) => target === canvas || target === document.body; // where nothing has the focus
      document.addEventListener("keydown", (event) => hears(event) && this.key(event));
      document.addEventListener("keyup", (event) => event.key === " " && app.peek(false));
    }

    place(event) {
      const { left, top } = this.canvas.getBoundingClientRect();
      return [(event.clientX - left) * this.app.ratio, (event.clientY - top) * this.app.ratio];
    }

    begin(event) {
      this.canvas.setPointerCapture(event.pointerId);
      const [first] = this.down.values();
      const last = this.presses.at(-1);
      // The first finger of two has moved the light.
      if (first && Math.hypot(first[0] - last.place[0], first[1] - last.place[1]) < STILL * this.app.ratio) this.takeBack(last);
      const press = { place: this.place(event), light: lightOf(this.app.state) };
      this.presses = [...this.presses.slice(-1), press];
      this.down.set(event.pointerId, press.place);
      this.panning = this.app.state.tool === "pan" || event.button > 0 || event.shiftKey || this.down.size > 1;
      this.app.drag(true);
      if (!this.panning) this.light(event);
    }

    move(event) {
      if (!this.down.has(event.pointerId)) return;
      const before = [...this.down.values()];
      const old = this.down.get(event.pointerId);
      const now = this.place(event);
      this.down.set(event.pointerId, now);
      if (this.down.size === 2) this.pinch(before, [...this.down.values()]);
      else if (this.panning) this.app.pan(now[0] - old[0], now[1] - old[1]);
      else this.light(event);
    }

    pinch([a, b], [c, d]) {
      const apart = (p, q) => Math.max(Math.hypot(p[0] - q[0], p[1] - q[1]), 1);
      const middle = (p, q) => [(p[0] + q[0]) / 2, (p[1] + q[1]) / 2];
      const [from, to] = [middle(a, b), middle(c, d)];
      this.app.pan(to[0] - from[0], to[1] - from[1]);
      this.app.zoom(apart(c, d) / apart(a, b), ...to);
    }

    end(event) {
      this.down.delete(event.pointerId);
      if (!this.down.size) this.app.drag(false);
    }

    /** The light as it was before a press: it meant something else. */
    takeBack({ light }) {
      Object.assign(this.app.state, structuredClone(light));
      this.app.changed();
    }

    /** The light follows the pointer: the middle of the picture is above it, its nearer edges are the horizon. */
    light(event) {
      const { left, top, width, height } = this.canvas.getBoundingClientRect();
      const radius = Math.min(width, height) / 2;
      const [x, y] = [event.clientX - left - width / 2, top + height / 2 - event.clientY];
      this.app.pointLight(directionOf(x / radius, y / radius));
    }

    wheel(event) {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 16 : 1;
      this.app.zoom(2 ** ((-event.deltaY * lines) / (event.ctrlKey ? 100 : 320)), ...this.place(event));
    }

    key(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const { app } = this;
      const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      const arrow = arrows[event.key];
      if (arrow && event.shiftKey) app.pan(-arrow[0] * 60 * app.ratio, arrow[1] * 60 * app.ratio);
      else if (arrow) app.nudgeLight(arrow[0] * STEP, arrow[1] * STEP);
      else if (event.key === "+" || event.key === "=") app.zoom(1.25);
      else if (event.key === "-") app.zoom(0.8);
      else if (event.key === "0") app.fit();
      else if (event.key === "1") app.zoom(1 / app.view.zoom);
      else if (event.key === "[") app.set("exposure", app.state.exposure - 0.25);
      else if (event.key === "]") app.set("exposure", app.state.exposure + 0.25);
      else if (event.key === "p") app.set("tool", app.state.tool === "pan" ? "light" : "pan");
      else if (event.key === "c") app.nextCompare();
      else if (event.key === " ") app.peek(true);
      else if (event.key === "h") app.panel.toggle();
      else if (event.key === "f") app.panel.fillScreen();
      else if (event.key === "s") app.save();
      else if (event.key === "?") document.getElementById("help").showModal();
      else return;
      event.preventDefault();
    }
  }

  Object.assign(clrelight, { Pointers });
})();
