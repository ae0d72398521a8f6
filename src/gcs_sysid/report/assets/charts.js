// Charts of report and page: lines with bands, levels and marks, and rows of spans, as SVG. Drag, or
// keys, to look closer; the values under the pointer are told beside the title. Nothing is loaded.
const charts = (() => {
  "use strict";

  const SVG = "http://www.w3.org/2000/svg";
  const HEIGHTS = { wide: 230, low: 150, medium: 220, small: 170, strip: 0 };
  const ROW = 30;
  const zooms = new Map(); // group -> [from, to] of x; none: all
  const drawn = [];

  function make(parent, name, attributes = {}, text = null) {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== null) node.textContent = text;
    if (parent) parent.append(node);
    return node;
  }

  // Scales, ticks, labels, and what of a series can be seen ---------------------------------------

  const linear = { of: (v) => v, back: (v) => v };
  const logarithmic = { of: Math.log10, back: (v) => 10 ** v };

  function ticks([low, high], most) {
    const raw = (high - low) / Math.max(most, 1);
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = power * ([1, 2, 5].find((k) => k * power >= raw * 0.999) ?? 10);
    const out = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(k * step);
    return { values: out, step };
  }

  function logTicks([low, high], most) {
    const decades = [];
    for (let k = Math.ceil(low - 1e-9); k <= high + 1e-9; k++) decades.push(k);
    if (decades.length >= 2) {
      const every = Math.ceil(decades.length / most);
      return decades.filter((k) => k % every === 0).map((k) => 10 ** k);
    }
    return ticks([10 ** low, 10 ** high], most).values.filter((v) => v > 0);
  }

  const signed = (text) => text.replace("-", "−");
  const raised = (k) =>
    String(k).replace(/[-0-9]/g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);

  function logLabel(value) {
    const power = Math.log10(value);
    if (Math.abs(power - Math.round(power)) > 1e-6 || Math.abs(power) < 2.5) {
      return signed(String(Number(value.toPrecision(3))));
    }
    return "10" + raised(Math.round(power));
  }

  // A power of ten that all labels of an axis share.
  function sharedPower([low, high]) {
    const size = Math.max(Math.abs(low), Math.abs(high));
    return size > 0 && (size < 0.1 || size >= 1e4) ? 3 * Math.floor(Math.log10(size) / 3) : 0;
  }

  function brief(value) {
    if (!Number.isFinite(value)) return "–";
    const power = sharedPower([value, value]);
    const text = signed(String(Number((value / 10 ** power).toPrecision(4))));
    return power ? `${text} × 10${raised(power)}` : text;
  }

  // Index of the first x that is not less.
  function place(x, at) {
    let low = 0, high = x.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (x[middle] < at) low = middle + 1; else high = middle;
    }
    return low;
  }

  // Of many points in one column of pixels the least and the greatest are seen.
  function thinned(x, y, from, to, most) {
    if (to - from <= 2 * most) return Array.from({ length: to - from }, (_, k) => from + k);
    const out = [], size = (to - from) / most;
    for (let b = 0; b < most; b++) {
      const first = from + Math.floor(b * size), last = from + Math.floor((b + 1) * size);
      let low = -1, high = -1, gap = -1;
      for (let i = first; i < last; i++) {
        if (!Number.isFinite(y[i])) { gap = i; continue; }
        if (low < 0 || y[i] < y[low]) low = i;
        if (high < 0 || y[i] > y[high]) high = i;
      }
      const kept = [low, high, gap].filter((i) => i >= 0).sort((a, b) => a - b);
      out.push(...new Set(kept));
    }
    return out;
  }

  // One figure ------------------------------------------------------------------------------------

  class Figure {
    // holder: element with a size's class, in a figure with places for the readout and the reset
    // button. spec: x, y, and what is drawn; series are arrays of numbers, NaN where they break.
    constructor(holder, spec) {
      this.holder = holder;
      this.size = Object.keys(HEIGHTS).find((name) => holder.classList.contains(name));
      const frame = holder.closest("figure");
      this.readout = frame.querySelector(".readout");
      this.button = frame.querySelector(".reset");
      this.pointed = null; // x on the picture
      this.id = `clip-${drawn.length}`;
      drawn.push(this);
      this.spec = spec;
      this.listen();
    }

    // Another spec, as more comes in.
    update(spec) {
      this.spec = spec;
      this.draw();
    }

    get rows() { return this.spec.rows ?? []; }
    get lines() { return this.spec.lines ?? []; }
    get bands() { return this.spec.bands ?? []; }
    get xs() { return this.spec.x.log ? logarithmic : linear; }
    get ys() { return this.spec.y?.log ? logarithmic : linear; }
    get all() { return this.extent(); }
    get range() { return zooms.get(this.spec.group) ?? this.all; }

    // The whole x axis, in its scale; figures of a group share it.
    extent() {
      let low = Infinity, high = -Infinity;
      for (const { spec } of drawn) {
        if (spec.group !== this.spec.group) continue;
        for (const { x } of spec.lines ?? []) {
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
      const include = (x, y) => {
        for (let i = Math.max(place(x, from) - 1, 0); i <= Math.min(place(x, to), x.length - 1); i++) {
          const v = this.ys.of(y[i]);
          if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
        }
      };
      for (const { x, y } of this.lines) include(x, y);
      for (const { x, low: lower, high: upper } of this.bands) {
        include(x, lower);
        include(x, upper);
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
      const digit = 0.42 * parseFloat(getComputedStyle(document.documentElement).fontSize);
      const left = strip ? (wordy ? 116 : 8) : Math.max(36, 12 + digit * longest);
      const svg = make(null, "svg", {
        viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": this.spec.title,
      });
      make(svg, "title", {}, this.spec.title);
      const clip = make(make(svg, "defs"), "clipPath", { id: this.id });
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
      const inside = make(svg, "g", { "clip-path": `url(#${this.id})` });

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
      if (this.pointed !== null) this.point(this.pointed);
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
      const { x, low, high } = band;
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
      const { x, y } = line;
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
        this.pointed = null;
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
      this.pointed = x;
      this.cursor.setAttribute("x1", x);
      this.cursor.setAttribute("x2", x);
      this.cursor.setAttribute("visibility", "visible");
      const at = this.xs.back(this.value(x));
      const words = [`${brief(at)} ${this.spec.x.unit}`];
      for (const line of this.lines) {
        let i = Math.min(place(line.x, at), line.x.length - 1);
        if (i > 0 && at - line.x[i - 1] < line.x[i] - at) i--;
        if (i >= 0) words.push(`${line.name} ${brief(line.y[i])}`);
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

  // A figure is drawn for its width, first as soon as it has one.
  const byHolder = new Map();
  const widths = new Map();
  const watch = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      if (widths.get(target) === target.clientWidth) continue;
      widths.set(target, target.clientWidth);
      byHolder.get(target).draw();
    }
  });

  // Series come as base64 of float32, by name, since figures share them.
  function unpack({ arrays, figures }) {
    const unpacked = {};
    for (const [name, packed] of Object.entries(arrays)) {
      const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
      const view = new DataView(bytes.buffer);
      unpacked[name] = Float64Array.from({ length: bytes.length / 4 }, (_, i) => view.getFloat32(4 * i, true));
    }
    for (const { lines, bands } of Object.values(figures)) {
      for (const series of [...lines ?? [], ...bands ?? []]) {
        for (const key of ["x", "y", "low", "high"]) if (key in series) series[key] = unpacked[series[key]];
      }
    }
    return figures;
  }

  return {
    unpack,
    // Draw figures, pairs of holder and spec.
    show(pairs) {
      const made = pairs.map(([holder, spec]) => new Figure(holder, spec));
      for (const figure of made) {
        byHolder.set(figure.holder, figure);
        figure.draw();
        watch.observe(figure.holder);
      }
      return made;
    },
  };
})();
