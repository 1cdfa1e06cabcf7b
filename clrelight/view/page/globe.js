// The hemisphere seen from above: where the lamp or the sun is, where lights were photographed, and where one drags.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});
  const { sunDirection } = clrelight;

  const RIM = 0.985; // a lamp lower than about ten degrees shows little but noise

  /** Direction of a place on a disc of radius 1, y up; what is beyond its rim is drawn to it. */
  function directionOf(x, y) {
    const radius = Math.hypot(x, y);
    const factor = radius > RIM ? RIM / radius : 1;
    const [a, b] = [x * factor, y * factor];
    return [a, b, Math.sqrt(1 - a * a - b * b)];
  }

  class Globe {
    constructor(canvas, app) {
      Object.assign(this, { canvas, app });
      canvas.addEventListener("pointerdown", (event) => {
        canvas.setPointerCapture(event.pointerId);
        app.drag(true);
        this.follow(event);
      });
      canvas.addEventListener("pointermove", (event) => canvas.hasPointerCapture(event.pointerId) && this.follow(event));
      for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => app.drag(false));
    }

    follow(event) {
      const { left, top, width, height } = this.canvas.getBoundingClientRect();
      const radius = (Math.min(width, height) / 2) * 0.92;
      const x = (event.clientX - left - width / 2) / radius;
      const y = (top + height / 2 - event.clientY) / radius;
      this.app.pointLight(directionOf(x, y));
    }

    draw(state, file) {
      const { canvas } = this;
      const ratio = Math.min(devicePixelRatio || 1, 3);
      const side = Math.round(canvas.clientWidth * ratio);
      if (!side) return;
      if (canvas.width !== side) canvas.width = canvas.height = side;
      const pen = canvas.getContext("2d");
      const [middle, radius] = [side / 2, (side / 2) * 0.92];
      pen.clearRect(0, 0, side, side);
      const at = state.light === "lamp" ? state.lamp.direction : state.light === "sky" ? sunDirection(state.sky, state.standing) : null;
      this.drawBall(pen, middle, radius, at);
      if (file.directions) this.drawLights(pen, middle, radius, file.directions, ratio);
      if (at && at[2] > 0) this.drawLamp(pen, middle + at[0] * radius, middle - at[1] * radius, ratio, state);
      if (state.light === "environment") this.drawTurn(pen, middle, radius, state.environment.turn, ratio);
    }

    drawBall(pen, middle, radius, at) {
      const [x, y] = at ? [middle + at[0] * radius * 0.75, middle - at[1] * radius * 0.75] : [middle, middle - radius / 2];
      const shade = pen.createRadialGradient(x, y, 0, x, y, radius * 1.9);
      shade.addColorStop(0, "#6d685f");
      shade.addColorStop(0.35, "#3b3a39");
      shade.addColorStop(1, "#17181a");
      pen.fillStyle = shade;
      pen.beginPath();
      pen.arc(middle, middle, radius, 0, 2 * Math.PI);
      pen.fill();
      pen.strokeStyle = "rgba(255, 255, 255, 0.13)";
      pen.lineWidth = radius / 110;
      pen.stroke();
      pen.strokeStyle = "rgba(255, 255, 255, 0.06)";
      for (const elevation of [30, 60]) {
        pen.beginPath();
        pen.arc(middle, middle, radius * Math.cos((elevation * Math.PI) / 180), 0, 2 * Math.PI);
        pen.stroke();
      }
    }

    drawLights(pen, middle, radius, directions, ratio) {
      pen.fillStyle = "rgba(255, 255, 255, 0.28)";
      const size = (directions.length > 900 ? 0.8 : 1.3) * ratio;
      for (let i = 0; i < directions.length; i += 3) {
        if (directions[i + 2] < 0) continue;
        pen.beginPath();
        pen.arc(middle + directions[i] * radius, middle - directions[i + 1] * radius, size, 0, 2 * Math.PI);
        pen.fill();
      }
    }

    drawLamp(pen, x, y, ratio, state) {
      const extent = (6 + 0.55 * state.lamp.softness) * ratio;
      const glow = pen.createRadialGradient(x, y, 0, x, y, extent * 3);
      glow.addColorStop(0, "rgba(255, 214, 140, 0.75)");
      glow.addColorStop(1, "rgba(255, 200, 110, 0)");
      pen.fillStyle = glow;
      pen.beginPath();
      pen.arc(x, y, extent * 3, 0, 2 * Math.PI);
      pen.fill();
      pen.fillStyle = "#ffe9c4";
      pen.beginPath();
      pen.arc(x, y, 5 * ratio, 0, 2 * Math.PI);
      pen.fill();
      pen.strokeStyle = "#14110b";
      pen.lineWidth = ratio;
      pen.stroke();
    }

    drawTurn(pen, middle, radius, turn, ratio) {
      const angle = (-turn * Math.PI) / 180;
      pen.strokeStyle = "#f2b867";
      pen.lineWidth = 2.5 * ratio;
      pen.beginPath();
      pen.arc(middle, middle, radius, angle - 0.4, angle + 0.4);
      pen.stroke();
    }
  }

  Object.assign(clrelight, { Globe, directionOf });
})();
