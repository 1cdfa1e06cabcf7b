// Which part of the image is shown, how large, and what that means for levels and tiles.
"use strict";
(() => {
  const clrelight = (globalThis.clrelight ??= {});

  const LARGEST = 32; // pixels of the screen for one of the image

  class View {
    constructor(width, height) {
      Object.assign(this, { imageWidth: width, imageHeight: height, width: 1, height: 1, x: width / 2, y: height / 2, zoom: 1 });
      this.fitted = true;
    }

    /** The screen has another size, in its own pixels. */
    resize(width, height) {
      this.width = width;
      this.height = height;
      if (this.fitted) this.fit();
      else this.clamp();
    }

    get fitZoom() {
      return Math.min(this.width / this.imageWidth, this.height / this.imageHeight);
    }

    fit() {
      this.zoom = this.fitZoom;
      this.x = this.imageWidth / 2;
      this.y = this.imageHeight / 2;
      this.fitted = true;
    }

    /** Zoom by a factor about a place on the screen. */
    zoomAt(factor, screenX = this.width / 2, screenY = this.height / 2) {
      const [x, y] = this.toImage(screenX, screenY);
      this.zoom = Math.min(Math.max(this.zoom * factor, Math.min(this.fitZoom, 1) / 2), Math.max(LARGEST, this.fitZoom));
      this.x = x - (screenX - this.width / 2) / this.zoom;
      this.y = y - (screenY - this.height / 2) / this.zoom;
      this.fitted = false;
      this.clamp();
    }

    pan(right, down) {
      this.x -= right / this.zoom;
      this.y -= down / this.zoom;
      this.fitted = false;
      this.clamp();
    }

    clamp() {
      this.x = Math.min(Math.max(this.x, 0), this.imageWidth);
      this.y = Math.min(Math.max(this.y, 0), this.imageHeight);
    }

    toImage(screenX, screenY) {
      return [this.x + (screenX - this.width / 2) / this.zoom, this.y + (screenY - this.height / 2) / this.zoom];
    }

    /** Left, top, right and bottom of what is seen, in pixels of the image; null where nothing is. */
    get seen() {
      const [left, top] = this.toImage(0, 0);
      const [right, bottom] = this.toImage(this.width, this.height);
      const part = [Math.max(left, 0), Math.max(top, 0), Math.min(right, this.imageWidth), Math.min(bottom, this.imageHeight)];
      return part[0] < part[2] && part[1] < part[3] ? part : null;
    }

    /** The level of which a pixel is about one of the screen. */
    levelFor(levels) {
      return Math.min(Math.max(Math.floor(Math.log2(1 / this.zoom) + 0.5), 0), levels);
    }

    /** Corners of a part of the image on the screen, from -1 to 1, y up. */
    toClip([left, top, right, bottom]) {
      const x = (value) => ((value - this.x) * this.zoom * 2) / this.width;
      const y = (value) => ((this.y - value) * this.zoom * 2) / this.height;
      return [x(left), y(bottom), x(right), y(top)];
    }
  }

  Object.assign(clrelight, { View });
})();
