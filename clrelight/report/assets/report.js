"use strict";

// Tables: a click or Enter on a heading sorts by it, another one turns the order. What was not measured stays last.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending";
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const words = head.classList.contains("words");
    const value = (row) => {
      const text = row.cells[column].dataset.value;
      return words ? text : text === "" ? NaN : Number(text);
    };
    const order = (a, b) => {
      const [x, y] = [value(a), value(b)];
      if (words) return down ? y.localeCompare(x) : x.localeCompare(y);
      if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
      return x === y ? 0 : (x < y) === down ? 1 : -1;
    };
    body.append(...[...body.rows].sort(order));
  }));
}

// Pictures beside each other: left of the bar one, right of it another, or its error.
for (const box of document.querySelectorAll(".compare")) {
  const shown = JSON.parse(box.querySelector("script").textContent);
  const pick = (name) => box.querySelector(`[name="${name}"]`);
  const [left, right, kind, at] = ["left", "right", "kind", "at"].map(pick);
  const pair = box.querySelector(".pair");
  const [one, other] = pair.querySelectorAll("img");
  const bar = pair.querySelector(".bar");
  const slide = () => {
    other.style.clipPath = `inset(0 0 0 ${at.value}%)`;
    bar.style.left = `${at.value}%`;
    at.setAttribute("aria-valuetext", `left picture up to ${at.value} percent`);
  };
  const show = () => {
    const [a, b] = [shown[left.value], shown[right.value]];
    const map = b[kind.value] ? kind.value : "picture";
    one.src = a.picture;
    one.alt = a.name;
    other.src = b[map];
    other.alt = map === "picture" ? b.name : `${kind.selectedOptions[0].text} of ${b.name}`;
    box.querySelector("output").textContent =
      `Left: ${a.name}${a.facts ? `, ${a.facts}` : ""}. Right: ${other.alt}${b.facts ? `, ${b.facts}` : ""}.`;
  };
  const drag = (event) => {
    const place = pair.getBoundingClientRect();
    at.value = Math.round((100 * (event.clientX - place.left)) / place.width);
    slide();
  };
  pair.addEventListener("pointerdown", (event) => {
    pair.setPointerCapture(event.pointerId);
    drag(event);
  });
  pair.addEventListener("pointermove", (event) => { if (event.buttons) drag(event); });
  for (const control of [left, right, kind]) control.addEventListener("change", show);
  at.addEventListener("input", slide);
  show();
  slide();
}
