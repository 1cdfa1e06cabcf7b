// The controls beside the picture: they show the state, and change it.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { bytesText } = clrelight;

  const byId = (id) => document.getElementById(id);
  const signed = (v) => `${v < 0 ? "−" : "+"}${Math.abs(v).toFixed(2)}`;
  const degrees = (v) => `${Math.round(v)}°`;

  // Of each slider where its value is in the state, and how it is written.
  const SLIDERS = {
    softness: [["lamp", "softness"], degrees],
    "sun-height": [["sky", "height"], degrees],
    "sun-azimuth": [["sky", "azimuth"], degrees],
    "sun-share": [["sky", "sun"], (v) => `${Math.round(100 * v)} %`],
    turn: [["environment", "turn"], degrees],
    exposure: [["exposure"], (v) => `${signed(v)} stops`],
    "error-gain": [["errorGain"], (v) => `× ${v}`],
  };
  const CHOICES = { light: ["light"], compare: ["compare"], curve: ["curve"], tool: ["tool"] };
  const SELECTS = { sky: ["sky", "table"], environment: ["environment", "table"], first: ["first"], second: ["second"] };

  const read = (state, path) => path.reduce((value, name) => value[name], state);

  class Panel {
    constructor(app, manifest) {
      Object.assign(this, { app, manifest });
      this.bind();
      this.fill();
    }

    bind() {
      const { app } = this;
      for (const [id, [path]] of Object.entries(SLIDERS)) {
        const slider = byId(id);
        const moves = path.length > 1; // light: what the picture shows of it costs little
        slider.addEventListener("input", () => {
          if (moves) app.drag(true);
          app.set(path, Number(slider.value));
        });
        slider.addEventListener("change", () => app.drag(false));
      }
      for (const [name, path] of Object.entries(CHOICES))
        for (const input of document.querySelectorAll(`input[name=${name}]`))
          input.addEventListener("change", () => app.set(path, input.value));
      for (const [id, path] of Object.entries(SELECTS))
        byId(id).addEventListener("change", () => app.set(path, Number(byId(id).value)));
      byId("standing").addEventListener("change", () => app.set("standing", byId("standing").checked));
      byId("auto").addEventListener("click", () => app.exposeAutomatically());
      byId("fit").addEventListener("click", () => app.fit());
      byId("actual").addEventListener("click", () => app.zoom(1 / app.view.zoom));
      byId("zoom-in").addEventListener("click", () => app.zoom(1.5));
      byId("zoom-out").addEventListener("click", () => app.zoom(1 / 1.5));
      byId("save").addEventListener("click", () => app.save());
      byId("fold").addEventListener("click", () => this.toggle());
      byId("full").hidden = !document.fullscreenEnabled;
      byId("full").addEventListener("click", () => this.fillScreen());
      byId("help-open").addEventListener("click", () => byId("help").showModal());
      byId("copy").addEventListener("click", () => this.copy());
      this.bindSplit();
    }

    bindSplit() {
      const { app } = this;
      const handle = byId("split");
      const follow = (event) => {
        const { left, width } = byId("picture").getBoundingClientRect();
        app.set("split", Math.min(Math.max((event.clientX - left) / width, 0), 1));
      };
      handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
      handle.addEventListener("pointermove", (event) => handle.hasPointerCapture(event.pointerId) && follow(event));
      handle.addEventListener("keydown", (event) => {
        const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
        if (!step) return;
        event.preventDefault();
        app.set("split", Math.min(Math.max(app.state.split + step, 0), 1));
      });
    }

    /** Offer what the manifest has. */
    fill() {
      const { files, skies, environments } = this.manifest;
      const offer = (id, names) => byId(id).replaceChildren(...names.map((name, i) => new Option(name, i)));
      offer("sky", skies.map((sky) => sky.name.replace("-", " ")));
      offer("environment", environments.map((each) => each.name));
      const names = files.map((file) => `${file.name} · ${file.codec} · ${bytesText(file.bytes)}`);
      offer("first", names);
      offer("second", names);
      byId("comparison").hidden = files.length < 2;
      for (const each of [byId("light-environment"), document.querySelector("label[for=light-environment]")]) {
        each.hidden = !environments.length;
      }
    }

    toggle() {
      const folded = document.body.classList.toggle("folded");
      byId("fold").setAttribute("aria-expanded", String(!folded));
      byId("fold").setAttribute("aria-label", folded ? "Show controls" : "Hide controls");
    }

    fillScreen() {
      if (document.fullscreenElement) document.exitFullscreen();
      else document.documentElement.requestFullscreen?.().catch(() => this.say("The browser does not allow full screen"));
    }

    /** Show the state. */
    update(state) {
      const { files } = this.manifest;
      for (const [id, [path, text]] of Object.entries(SLIDERS)) {
        const value = read(state, path);
        byId(id).value = value;
        byId(id).setAttribute("aria-valuetext", text(value));
        byId(`${id}-value`).textContent = text(value);
      }
      for (const [name, path] of Object.entries(CHOICES)) {
        const value = read(state, path);
        for (const input of document.querySelectorAll(`input[name=${name}]`)) input.checked = input.value === value;
      }
      for (const [id, path] of Object.entries(SELECTS)) byId(id).value = read(state, path);
      byId("standing").checked = state.standing;
      for (const each of document.querySelectorAll("[data-for]")) each.hidden = !each.dataset.for.split(" ").includes(state.light);
      byId("error-row").hidden = state.compare !== "error";
      byId("second-row").hidden = state.compare === "one";
      const photographs = this.app.shownFiles().some((file) => file.kind === "photographs");
      for (const id of ["light-sky", "light-environment"]) byId(id).disabled = photographs;
      byId("photograph-note").hidden = !photographs;
      this.showSplit(state);
      const file = files[state.first];
      const grid = file.degree === undefined ? `${file.lights} lights` : `degree ${file.degree}`;
      byId("facts").textContent = [`${file.width} × ${file.height}`, file.codec, grid, bytesText(file.bytes)].join(" · ");
      byId("command").textContent = this.app.command();
    }

    showSplit(state) {
      const handle = byId("split");
      handle.hidden = state.compare !== "split";
      handle.style.left = `${100 * state.split}%`;
      handle.setAttribute("aria-valuenow", Math.round(100 * state.split));
      byId("split-first").textContent = this.manifest.files[state.first].name;
      byId("split-second").textContent = this.manifest.files[state.second].name;
    }

    figure(text) {
      const parts = text.split(" · ").map((part) => Object.assign(document.createElement("span"), { textContent: part }));
      byId("figure").replaceChildren(...parts.flatMap((part, i) => (i ? [" · ", part] : [part])));
    }

    say(text) {
      byId("spoken").textContent = text;
    }

    fault(text) {
      byId("fault").hidden = !text;
      byId("fault").textContent = text;
    }

    async copy() {
      const text = byId("command").textContent;
      try {
        await navigator.clipboard.writeText(text);
        this.say("Command copied");
        byId("copy").textContent = "Copied";
        setTimeout(() => (byId("copy").textContent = "Copy"), 1200);
      } catch {
        getSelection().selectAllChildren(byId("command")); // no clipboard for files: it can be copied by hand
      }
    }
  }

  Object.assign(clrelight, { Panel });
})();
