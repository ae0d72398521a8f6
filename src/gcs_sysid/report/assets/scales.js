// Scales, ticks, labels, and what of a series can be seen.
const scales = (() => {
  "use strict";

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

  return {
    linear, logarithmic, ticks, logTicks, signed, raised, logLabel, sharedPower, brief, place, thinned,
  };
})();
