// Draws the figures of a report. Data come from the element #data; nothing is loaded.
(() => {
  "use strict";

  const SVG = "http://www.w3.org/2000/svg";
  const HEIGHTS = { wide: 230, low: 150, medium: 220, small: 170, strip: 0 };
  const ROW = 30;
  const PRINTED = 660;
  const { arrays: packed, figures } = JSON.parse(document.getElementById("data").textContent);
  const unpacked = new Map();
  const zooms = new Map(); // group -> [from, to] of x; none: all
  const drawn = [];

  function array(name) {
    if (!unpacked.has(name)) {
      const bytes = Uint8Array.from(atob(packed[name]), (c) => c.charCodeAt(0));
      const view = new DataView(bytes.buffer);
      const out = new Float64Array(bytes.length / 4);
      for (let i = 0; i < out.length; i++) out[i] = view.getFloat32(4 * i, true);
      unpacked.set(name, out);
    }
    return unpacked.get(name);
  }

  function make(parent, name, attributes = {}, text = null) {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== null) node.textContent = text;
    if (parent) parent.append(node);
    return node;
  }

  const {
    linear, logarithmic, ticks, logTicks, signed, raised, logLabel, sharedPower, brief, place, thinned,
  } = scales;

  // One figure ---------------------------------------------------------------------------------

  class Figure {
    constructor(holder) {
      this.holder = holder;
      this.spec = figures[holder.dataset.figure];
      this.size = Object.keys(HEIGHTS).find((name) => holder.classList.contains(name));
      const frame = holder.closest("figure");
      this.readout = frame.querySelector(".readout");
      this.button = frame.querySelector(".reset");
      this.xs = this.spec.x.log ? logarithmic : linear;
      this.ys = this.spec.y?.log ? logarithmic : linear;
      this.all = this.extent();
      this.listen();
    }

    get rows() { return this.spec.rows ?? []; }
    get lines() { return this.spec.lines ?? []; }
    get bands() { return this.spec.bands ?? []; }
    get range() { return zooms.get(this.spec.group) ?? this.all; }

    // The whole x axis, in its scale; figures of a group share it.
    extent() {
      let low = Infinity, high = -Infinity;
      for (const spec of Object.values(figures)) {
        if (spec.group !== this.spec.group) continue;
        for (const line of spec.lines ?? []) {
          const x = array(line.x);
          if (x.length) { low = Math.min(low, x[0]); high = Math.max(high, x[x.length - 1]); }
        }
        for (const [a, b] of (spec.rows ?? []).flatMap((row) => row.spans)) {
          low = Math.min(low, a); high = Math.max(high, b);
        }
      }
      if (!(high > low)) high = low + 1;
      return [this.xs.of(low), this.xs.of(high)];
    }

    // What y spans, in its scale.
    span() {
      const zoomed = zooms.has(this.spec.group);
      if (this.spec.y.range && !zoomed) return this.spec.y.range;
      const [from, to] = this.range.map(this.xs.back);
      let low = Infinity, high = -Infinity;
      const take = (x, y) => {
        for (let i = Math.max(place(x, from) - 1, 0); i <= Math.min(place(x, to), x.length - 1); i++) {
          const v = this.ys.of(y[i]);
          if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
        }
      };
      for (const line of this.lines) take(array(line.x), array(line.y));
      for (const band of this.bands) {
        take(array(band.x), array(band.low));
        take(array(band.x), array(band.high));
      }
      if (!(high >= low)) return [-1, 1];
      const room = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
      return [low - room, high + room];
    }

    draw(width = this.holder.clientWidth) {
      if (width < 40) return;
      const strip = this.size === "strip";
      const narrow = width < 520;
      const wordy = strip && !narrow;
      const height = strip ? this.rows.length * (wordy ? ROW : ROW + 12) + 52 : HEIGHTS[this.size];
      const top = 18, bottom = height - 32, right = width - 10;
      const yRange = strip ? [0, 1] : this.span();
      const yTicks = strip ? [] : this.yTicks(yRange, (bottom - top) / 24);
      const longest = Math.max(...yTicks.map((tick) => tick.text.length), 2);
      const left = strip ? (wordy ? 116 : 8) : Math.max(36, 12 + 6.7 * longest);
      const svg = make(null, "svg", {
        viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": this.spec.title,
      });
      make(svg, "title", {}, this.spec.title);
      const id = `clip-${this.holder.dataset.figure}`;
      const clip = make(make(svg, "defs"), "clipPath", { id });
      make(clip, "rect", { x: left, y: top, width: right - left, height: bottom - top });
      const [a, b] = this.range;
      this.frame = { left, right, top, bottom, width };
      const X = (v) => left + ((this.xs.of(v) - a) / (b - a)) * (right - left);
      const Y = (v) => bottom - ((this.ys.of(v) - yRange[0]) / (yRange[1] - yRange[0])) * (bottom - top);
      const bounded = (v) => Math.max(-1e4, Math.min(1e4, v));

      for (const { value, text } of yTicks) {
        const y = Y(value);
        make(svg, "line", { x1: left, x2: right, y1: y, y2: y, class: "gridline" });
        make(svg, "text", { x: left - 6, y: y + 4, class: "tick end" }, text);
      }
      this.drawXTicks(svg, X);
      if (!strip) make(svg, "text", { x: left, y: 11, class: "unit" }, this.unitText(yRange));
      const inside = make(svg, "g", { "clip-path": `url(#${id})` });

      this.rows.forEach((row, k) => {
        const slot = (bottom - top) / this.rows.length;
        const y = top + k * slot + (wordy ? 7 : 17), tall = slot - (wordy ? 14 : 22);
        make(svg, "text", wordy ? { x: left - 10, y: y + tall / 2 + 4, class: "row end" }
          : { x: left, y: y - 5, class: "row" }, row.name);
        make(inside, "line", { x1: left, x2: right, y1: y + tall, y2: y + tall, class: "gridline" });
        for (const [from, to] of row.spans) {
          const x = bounded(X(from));
          make(inside, "rect", {
            x, y, width: Math.max(bounded(X(to)) - x, 1), height: tall, class: `span ${row.class}`,
          });
        }
      });
      for (const band of this.bands) this.drawBand(inside, band, X, Y, bounded);
      for (const level of this.spec.levels ?? []) {
        make(inside, "line", { x1: left, x2: right, y1: Y(level.y), y2: Y(level.y), class: "level" });
      }
      for (const line of this.lines) this.drawLine(inside, line, X, Y, bounded);
      this.drawMarks(svg, X);
      make(svg, "line", { x1: left, x2: right, y1: bottom, y2: bottom, class: "axis" });
      this.cursor = make(svg, "line", { y1: top, y2: bottom, class: "cursor", visibility: "hidden" });
      this.brush = make(svg, "rect", { y: top, height: bottom - top, class: "brush", visibility: "hidden" });
      this.holder.replaceChildren(svg);
      this.button.hidden = !zooms.has(this.spec.group);
    }

    yTicks(range, most) {
      if (this.spec.y.log) {
        return logTicks(range, most).map((value) => ({ value, text: logLabel(value) }));
      }
      const power = 10 ** sharedPower(range);
      const { values, step } = ticks(range.map((v) => v / power), most);
      const digits = Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 9);
      return values.map((v) => ({ value: v * power, text: signed((v + 0).toFixed(digits).replace(/^-(0\.?0*)$/, "$1")) }));
    }

    unitText(range) {
      const power = this.spec.y.log ? 0 : sharedPower(range);
      return [power ? `× 10${raised(power)}` : "", this.spec.y.unit].join(" ").trim();
    }

    drawXTicks(svg, X) {
      const { left, right, bottom } = this.frame;
      const most = Math.max(3, (right - left) / 64);
      let labels;
      if (this.spec.x.log) {
        labels = logTicks(this.range, most).map((value) => ({ value, text: logLabel(value) }));
      } else {
        const { values, step } = ticks(this.range, most);
        const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
        labels = values.map((value) => ({ value, text: signed(value.toFixed(digits)) }));
      }
      const unit = this.spec.x.unit;
      for (const { value, text } of labels) {
        const x = X(value);
        if (x > right + 1 || x < left - 1) continue;
        make(svg, "line", { x1: x, x2: x, y1: bottom, y2: bottom + 4, class: "axis" });
        if (x < right - 26) make(svg, "text", { x, y: bottom + 17, class: "tick middle" }, text);
      }
      make(svg, "text", { x: right, y: bottom + 17, class: "tick end unit" }, unit);
    }

    drawBand(parent, band, X, Y, bounded) {
      const x = array(band.x), low = array(band.low), high = array(band.high);
      const [from, to] = this.visible(x);
      let upper = [], lower = [], d = "";
      const flush = () => {
        if (upper.length > 1) d += "M" + upper.join("L") + "L" + lower.reverse().join("L") + "Z";
        upper = []; lower = [];
      };
      for (let i = from; i < to; i++) {
        if (!Number.isFinite(low[i]) || !Number.isFinite(high[i])) { flush(); continue; }
        const u = X(x[i]).toFixed(1);
        upper.push(`${u} ${bounded(Y(high[i])).toFixed(1)}`);
        lower.push(`${u} ${bounded(Y(low[i])).toFixed(1)}`);
      }
      flush();
      make(parent, "path", { d, class: "band" });
    }

    drawLine(parent, line, X, Y, bounded) {
      const x = array(line.x), y = array(line.y);
      const [from, to] = this.visible(x);
      let d = "", pen = false;
      for (const i of thinned(x, y, from, to, Math.ceil(this.frame.right - this.frame.left))) {
        const v = Y(y[i]);
        if (!Number.isFinite(v)) { pen = false; continue; }
        d += `${pen ? "L" : "M"}${bounded(X(x[i])).toFixed(1)} ${bounded(v).toFixed(1)}`;
        pen = true;
      }
      make(parent, "path", { d, class: `line ${line.class}` });
    }

    drawMarks(svg, X) {
      const { left, right, top, bottom } = this.frame;
      let last = -Infinity;
      for (const mark of this.spec.marks ?? []) {
        const x = X(mark.x);
        if (x < left || x > right) continue;
        const group = make(svg, "g", { class: "mark" });
        make(group, "line", { x1: x, x2: x, y1: top - 3, y2: bottom });
        if (x - last < 16) continue;
        last = x;
        make(group, "circle", { cx: x, cy: top - 9, r: 8 });
        make(group, "text", { x, y: top - 5 }, mark.label);
        make(group, "title", {}, `${mark.label}: ${mark.text}`);
      }
    }

    visible(x) {
      const [from, to] = this.range.map(this.xs.back);
      return [Math.max(place(x, from) - 1, 0), Math.min(place(x, to) + 1, x.length)];
    }

    // Looking closer ---------------------------------------------------------------------------

    at(event) {
      const box = this.holder.firstElementChild.getBoundingClientRect();
      const { left, right, width } = this.frame;
      const x = ((event.clientX - box.left) / box.width) * width;
      return Math.min(Math.max(x, left), right);
    }

    // Of a place on the picture the value, in the axis' scale.
    value(x) {
      const { left, right } = this.frame, [a, b] = this.range;
      return a + ((x - left) / (right - left)) * (b - a);
    }

    listen() {
      const holder = this.holder;
      let start = null;
      holder.addEventListener("pointerdown", (event) => {
        if (event.button !== 0 || !this.frame) return;
        start = this.at(event);
        holder.setPointerCapture(event.pointerId);
      });
      holder.addEventListener("pointermove", (event) => {
        if (!this.frame) return;
        const x = this.at(event);
        this.point(x);
        if (start === null) return;
        this.brush.setAttribute("x", Math.min(start, x));
        this.brush.setAttribute("width", Math.abs(x - start));
        this.brush.setAttribute("visibility", "visible");
      });
      const drop = () => {
        start = null;
        this.brush?.setAttribute("visibility", "hidden");
      };
      holder.addEventListener("pointerup", (event) => {
        if (start === null) return;
        const [from, to] = [start, this.at(event)].sort((p, q) => p - q);
        drop();
        if (to - from > 6) this.zoom(this.value(from), this.value(to));
      });
      holder.addEventListener("pointercancel", drop);
      holder.addEventListener("pointerleave", () => {
        this.cursor?.setAttribute("visibility", "hidden");
        this.readout.textContent = "";
      });
      holder.addEventListener("dblclick", () => this.reset());
      this.button.addEventListener("click", () => {
        this.reset();
        holder.focus();
      });
      holder.addEventListener("keydown", (event) => {
        if (event.ctrlKey || event.metaKey || event.altKey) return;
        const [a, b] = this.range, tenth = (b - a) / 10;
        const acts = {
          "+": () => this.zoom(a + 2.5 * tenth, b - 2.5 * tenth),
          "-": () => this.zoom(a - 5 * tenth, b + 5 * tenth),
          ArrowLeft: () => this.move(-2 * tenth),
          ArrowRight: () => this.move(2 * tenth),
          0: () => this.reset(),
          Escape: () => this.reset(),
        };
        acts["="] = acts["+"];
        acts["_"] = acts["−"] = acts["-"];
        if (!acts[event.key]) return;
        event.preventDefault();
        acts[event.key]();
      });
    }

    point(x) {
      this.cursor.setAttribute("x1", x);
      this.cursor.setAttribute("x2", x);
      this.cursor.setAttribute("visibility", "visible");
      const at = this.xs.back(this.value(x));
      const words = [`${brief(at)} ${this.spec.x.unit}`];
      for (const line of this.lines) {
        const xs = array(line.x);
        let i = Math.min(place(xs, at), xs.length - 1);
        if (i > 0 && at - xs[i - 1] < xs[i] - at) i--;
        if (i >= 0) words.push(`${line.name} ${brief(array(line.y)[i])}`);
      }
      this.readout.textContent = words.join(" · ");
    }

    move(by) {
      if (!zooms.has(this.spec.group)) return;
      const [a, b] = this.range;
      const step = Math.max(this.all[0] - a, Math.min(by, this.all[1] - b));
      this.zoom(a + step, b + step);
    }

    zoom(from, to) {
      const [low, high] = this.all, all = high - low;
      from = Math.max(from, low);
      to = Math.min(to, high);
      if (to - from < 1e-4 * all) return;
      if (to - from > 0.999 * all) zooms.delete(this.spec.group);
      else zooms.set(this.spec.group, [from, to]);
      this.redrawGroup();
    }

    reset() {
      zooms.delete(this.spec.group);
      this.redrawGroup();
    }

    redrawGroup() {
      for (const other of drawn) if (other.spec.group === this.spec.group) other.draw();
    }
  }

  for (const holder of document.querySelectorAll("[data-figure]")) drawn.push(new Figure(holder));
  const byHolder = new Map(drawn.map((figure) => [figure.holder, figure]));
  const widths = new Map();
  const watch = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      if (widths.get(target) === target.clientWidth) continue;
      widths.set(target, target.clientWidth);
      byHolder.get(target).draw();
    }
  });
  for (const figure of drawn) {
    figure.draw();
    watch.observe(figure.holder);
  }
  addEventListener("beforeprint", () => {
    for (const details of document.querySelectorAll("details")) details.open = true;
    for (const figure of drawn) figure.draw(figure.size === "small" || figure.size === "medium" ? PRINTED / 2.1 : PRINTED);
  });
  addEventListener("afterprint", () => drawn.forEach((figure) => figure.draw()));
})();
