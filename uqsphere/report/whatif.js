"use strict";
// What if: the rows of a run asked again for other strengths, targets, speeds and sizes.  Units are SI, demands in ln.
(function (root) {
  // --- numbers ---------------------------------------------------------------------------------------------------

  function lnGamma(x) { // Lanczos, g = 7, nine terms
    const c = [0.99999999999980993, 676.5203681218851, -1259.1392167224028, 771.32342877765313, -176.61502916214059,
      12.507343278686905, -0.13857109526572012, 9.9843695780195716e-6, 1.5056327351493116e-7];
    let sum = c[0];
    for (let k = 1; k < 9; k++) sum += c[k] / (x - 1 + k);
    return 0.5 * Math.log(2 * Math.PI) + (x - 0.5) * Math.log(x + 6.5) - (x + 6.5) + Math.log(sum);
  }

  function below(z) { // share of a normal law below z, to 1e-7 of itself (Press et al., erfc by Chebyshev's polynomials)
    const a = Math.abs(z) * Math.SQRT1_2, t = 1 / (1 + 0.5 * a);
    const tail = 0.5 * t * Math.exp(-a * a - 1.26551223 + t * (1.00002368 + t * (0.37409196 + t * (0.09678418 +
      t * (-0.18628806 + t * (0.27886807 + t * (-1.13520398 + t * (1.48851587 + t * (-0.82215223 + t * 0.17087277)))))))));
    return z < 0 ? tail : 1 - tail;
  }

  function score(p) { // normal score of a share, by Newton's steps
    if (p <= 0 || p >= 1) return p <= 0 ? -38 : 38;
    const q = Math.min(p, 1 - p), t = Math.sqrt(-2 * Math.log(q));
    let z = t - (2.30753 + 0.27061 * t) / (1 + t * (0.99229 + 0.04481 * t));
    for (let k = 0; k < 3; k++) z += (below(-z) - q) / (Math.exp(-0.5 * z * z) / Math.sqrt(2 * Math.PI));
    return p < 0.5 ? -z : z;
  }

  const logit = (p, q) => Math.log(p) - Math.log(q);
  const share = l => 1 / (1 + Math.exp(-l));
  const STUDENT = [12.71, 4.3, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.2, 2.18, 2.16, 2.14, 2.131];

  function between(nodes, values, x) { // straight lines between places in ln
    let k = 1;
    while (k < nodes.length - 1 && nodes[k] < x) k++;
    const part = Math.log(x / nodes[k - 1]) / Math.log(nodes[k] / nodes[k - 1]);
    return values[k - 1] + part * (values[k] - values[k - 1]);
  }

  function unpacked([low, step, text]) {
    const raw = atob(text), out = new Float64Array(raw.length / 2);
    for (let i = 0; i < out.length; i++) out[i] = low + step * (raw.charCodeAt(2 * i) | (raw.charCodeAt(2 * i + 1) << 8));
    return out;
  }

  // --- rows: columns of the sample, and the products of powers of what scatters in them ---------------------------

  function makeRows(parts, sizes) { // the first rows of every randomisation; parts: [columns, how many rows each has]
    const own = {}, powers = new Map(), length = sizes.reduce((a, b) => a + b, 0);
    for (const [columns, counts] of parts) {
      const kept = [];
      counts.reduce((first, n, r) => { for (let i = 0; i < sizes[r]; i++) kept.push(first + i); return first + n; }, 0);
      for (const name in columns) own[name] = Float64Array.from(kept, i => columns[name][i]);
    }
    return {
      sizes, n: length, columns: own,
      product(key, names) { // of the columns `names` to the powers in the digits of a number, eight to a place
        if (!powers.has(key)) {
          const out = new Float64Array(length).fill(1);
          for (let k = 0, rest = key; rest > 0; k++, rest = Math.floor(rest / 8))
            for (let p = 0; p < rest % 8; p++) for (let i = 0; i < out.length; i++) out[i] *= own[names[k]][i];
          powers.set(key, out);
        }
        return powers.get(key);
      },
    };
  }

  function choose(n, k) { let out = 1; for (let j = 1; j <= k; j++) out = out * (n - k + j) / j; return out; }

  // --- the model: everything that the rows can be asked ------------------------------------------------------------

  function makeModel(data) {
    const unpack = packed => Object.fromEntries(Object.entries(packed).map(([name, column]) => [name, unpacked(column)]));
    const asked = [unpack(data.asked), data.counts], columns = unpack(data.moved), parts = [asked, [columns, data.few]];
    const atMost = most => data.few.map(n => Math.min(n, Math.ceil(most / data.few.length)));
    // for answers that nothing but the strength moves; for others; for verdicts; for every point of a curve
    const every = makeRows([asked], data.counts), many = makeRows(parts, data.few);
    const some = makeRows(parts, atMost(1024)), few = makeRows(parts, atMost(256));
    const names = data.axes.map(a => a[0]), sliders = new Map(data.sliders.map(s => [s.path, s]));
    const tables = data.weibull;

    // a surface as numbers: coefficients, and the powers of every axis
    const numbers = {}, BASE = 8;
    for (const q in data.surfaces) {
      const { p, c, error } = data.surfaces[q];
      numbers[q] = { c: Float64Array.from(c), p: p.map(text => Array.from(text, Number)), error };
    }

    // the terms of a surface at a setting: coefficients by what is left of a row, the powers of its columns as one number
    function terms(quantity, at) {
      const { c, p, error } = numbers[quantity], powersOf = [], found = new Map();
      data.axes.forEach(([name, middle, half]) => {
        const one = sliders.get(name), random = columns[name] !== undefined;
        const a = ((one ? between(one.nodes, one.centres, at[name]) : middle) - middle) / half;
        const b = random ? (one ? between(one.nodes, one.spreads, at[name]) / half : 1) : 0;
        powersOf.push(Array.from({ length: BASE }, (_, n) => // (a + b u)^n by powers of u; what no row feels is left out
          Array.from({ length: random ? n + 1 : 1 }, (_, k) => choose(n, k) * a ** (n - k) * b ** k)));
      });
      const keys = [], values = [];
      for (let t = 0; t < c.length; t++) {
        keys.length = values.length = 0;
        keys.push(0);
        values.push(c[t]);
        for (let k = 0, place = 1; k < p[t].length; k++, place *= BASE) {
          if (!p[t][k]) continue;
          const parts = powersOf[k][p[t][k]], known = keys.length;
          for (let m = 0; m < known; m++) {
            const value = values[m], key = keys[m];
            values[m] = value * parts[0];
            for (let n = 1; n < parts.length; n++) {
              const more = value * parts[n];
              if (Math.abs(more) * 3 ** n > 1e-4 * error) { keys.push(key + n * place); values.push(more); }
            }
          }
        }
        for (let m = 0; m < keys.length; m++) found.set(keys[m], (found.get(keys[m]) || 0) + values[m]);
      }
      for (const [key, value] of found) {
        let reach = Math.abs(value);
        for (let rest = key; rest > 0; rest = Math.floor(rest / BASE)) reach *= 3 ** (rest % BASE);
        if (reach < 0.01 * error) found.delete(key);
      }
      return found;
    }

    const still = Object.fromEntries(data.sliders.map(s => [s.path, s.base]));
    const base = {};
    for (const q in data.surfaces) base[q] = terms(q, still);

    function add(rows, out, found, sign) {
      for (const [key, c] of found) {
        const product = rows.product(key, names), f = sign * c;
        for (let i = 0; i < out.length; i++) out[i] += f * product[i];
      }
    }

    // ln demand of every row: the row's own moved by what the surface moves by, or the surface itself
    function demand(rows, limit, at) {
      const out = Float64Array.from(rows.columns["demand " + limit.name]);
      const surface = data.surfaces[limit.quantity];
      if (!surface || !moved(at)) return out;
      const found = terms(limit.quantity, at);
      for (const [key, c] of base[limit.quantity]) found.set(key, (found.get(key) || 0) - c);
      add(rows, out, found, 1);
      return out;
    }

    function surfaceOf(rows, quantity, at) {
      const out = new Float64Array(rows.n);
      add(rows, out, moved(at) ? terms(quantity, at) : base[quantity], 1);
      return out;
    }

    const moved = at => data.sliders.some(s => Math.abs(at[s.path] / s.base - 1) > 1e-9);
    const covered = at => data.sliders.every(s => at[s.path] >= s.low * (1 - 1e-9) && at[s.path] <= s.high * (1 + 1e-9));

    // a function of ln demand and of the score that ties the strength: shares (below, above) into a pair
    function shares(law, change, rho) {
      const rest = Math.sqrt(1 - rho * rho), shift = change.ratio;
      if (law.kind === "fixed") return (x, z, pair) => { pair[0] = x > law.ln + shift ? 1 : 0; pair[1] = 1 - pair[0]; };
      const scored = (s, z, pair) => { const u = (s - rho * z) / rest; pair[0] = below(u); pair[1] = below(-u); };
      if (law.kind === "lognormal") {
        const mean = law.mu + 0.5 * law.sd * law.sd + shift;
        const sd = change.scatter ? Math.sqrt(Math.log1p(change.scatter * change.scatter)) : law.sd;
        return (x, z, pair) => scored((x - mean + 0.5 * sd * sd) / sd, z, pair);
      }
      if (law.kind === "table") {
        const { from, step, scores } = law;
        return (x, z, pair) => {
          const at = Math.min(Math.max((x - shift - from) / step, 0), scores.length - 1.001), k = Math.floor(at);
          scored(scores[k] + (at - k) * (scores[k + 1] - scores[k]), z, pair);
        };
      }
      const mean = law.scale * Math.exp(lnGamma(1 + 1 / law.m)), ratio = Math.exp(-shift);
      const m = change.scatter || law.m, scale = Math.log(mean) - lnGamma(1 + 1 / m);
      const [from, step, scores] = tables;
      return (x, z, pair) => {
        let w = m * (x - shift - scale);
        if (law.threshold) {
          const over = Math.exp(x) * ratio - law.threshold;
          w = over > 0 ? m * (Math.log(over) - scale) : -80;
        }
        if (rho) {
          const at = Math.min(Math.max((w - from) / step, 0), scores.length - 1.001), k = Math.floor(at);
          return scored(scores[k] + (at - k) * (scores[k + 1] - scores[k]), z, pair);
        }
        const hazard = Math.exp(w);
        pair[0] = -Math.expm1(-hazard);
        pair[1] = Math.exp(-hazard);
      };
    }

    // chances of a miss and of none, each row's, with the sums that an interval takes
    function missed(rows, limit, setting, x, law, change, rho, aim) {
      const f = shares(law, change, rho), z = limit && limit.tie ? rows.columns["score " + limit.tie.with] : null;
      const chance = new Float64Array(rows.n), pair = [0, 0], event = [], other = [];
      const by = aim === "survive" ? 0 : 1;
      let i = 0;
      for (const size of rows.sizes) {
        let a = 0, b = 0;
        for (const end = i + size; i < end; i++) {
          f(x[i], z ? z[i] : 0, pair);
          chance[i] = pair[by];
          a += pair[by];
          b += pair[1 - by];
        }
        event.push(a / size);
        other.push(b / size);
      }
      return { chance, event, other };
    }

    const mean = list => list.reduce((a, b) => a + b, 0) / list.length;

    function logits(found) { // value and half-width of the 95 % interval, from the randomisations
      const p = mean(found.event), q = mean(found.other), small = p < q ? found.event : found.other, m = mean(small);
      if (!(p > 0 && q > 0)) return [p > 0 ? 38 : -38, 0];
      const r = small.length, sd = Math.sqrt(small.reduce((s, v) => s + (v - m) * (v - m), 0) / Math.max(r - 1, 1));
      const half = r > 1 ? STUDENT[Math.min(r - 2, 14)] * sd / Math.sqrt(r) / (p * q) : 0;
      return [logit(p, q), Math.min(half, 600)];
    }

    function change(limit, setting) {
      const own = setting.limits[limit.name];
      return { ratio: Math.log(own.mean / limit.mean), scatter: own.scatter };
    }

    const pearson = r => 2 * Math.sin(Math.PI * r / 6);
    const rhoOf = (limit, setting) => limit.tie ? pearson(setting.limits[limit.name].spearman) : 0;

    function own(rows, limit, setting, offset) {
      return missed(rows, limit, setting, offset ? demand(rows, limit, setting.at).map(v => v + offset) :
        demand(rows, limit, setting.at), limit.law, change(limit, setting), rhoOf(limit, setting), limit.aim);
    }

    function start() { // the study as it is
      const limits = {};
      for (const l of data.limits) limits[l.name] = { mean: l.mean, scatter: 0, spearman: l.tie ? l.tie.spearman : 0, target: l.target };
      return { at: { ...still }, limits, ways: new Set() };
    }

    const first = start();
    for (const limit of data.limits) { // how far the rows are from what the run knows better
      const [value, low, high] = limit.miss, known = logit(value, 1 - value);
      limit.off = new Map([every, many, some, few].map(rows => {
        const [found, half] = logits(own(rows, limit, first, 0));
        return [rows, Math.abs(found) < 38 && isFinite(known) ? [known - found, half] : [0, half]];
      }));
      limit.half = isFinite(known) ? [known - logit(Math.max(low, 1e-300), 1 - low), logit(Math.min(high, 1 - 1e-16), 1 - high) - known] : [0, 0];
      limit.half = limit.half.map(h => isFinite(h) ? Math.min(h, 600) : 600);
      for (const way of limit.ways) {
        const p = mean(wayChance(some, limit, way, first, 1).event);
        way.offset = p > 0 && p < 1 && way.miss > 0 && way.miss < 1 ? logit(way.miss, 1 - way.miss) - logit(p, 1 - p) : 0;
      }
    }

    function wayChance(rows, limit, way, setting, which, given) {
      let lift = 0;
      for (const name in way.scales) lift += between(sliders.get(name).nodes, way.scales[name], setting.at[name]);
      const x = given || surfaceOf(rows, way.quantity, setting.at);
      const found = missed(rows, null, setting, x, way.laws[which], { ratio: lift, scatter: 0 }, 0, limit.aim);
      if (way.offset) {
        for (let i = 0; i < x.length; i++) {
          const p = Math.min(Math.max(found.chance[i], 1e-300), 1 - 1e-16);
          found.chance[i] = share(logit(p, 1 - p) + way.offset);
        }
      }
      return found;
    }

    // the probability that a limit misses its aim, with its interval; exact from rows, or an estimate
    function answer(limit, setting) {
      if (!covered(setting.at)) return null;
      const kind = moved(setting.at) ? "estimate" : "exact", surface = data.surfaces[limit.quantity];
      if (kind === "estimate" && !surface) return null;
      const rows = kind === "exact" ? every : many, found = own(rows, limit, setting, 0), [value, half] = logits(found);
      const same = JSON.stringify(setting.limits[limit.name]) === JSON.stringify(first.limits[limit.name]);
      let low = 0, high = 0;
      if (kind === "estimate") {
        const ends = [-1, 1].map(s => logits(own(rows, limit, setting, s * surface.error))[0] - value);
        low = -Math.min(...ends);
        high = Math.max(...ends);
      }
      const [offset, baseHalf] = limit.off.get(rows), centre = value + offset;
      const more = kind === "exact" && sameLaw(limit, setting) ? 0 : Math.hypot(half, baseHalf);
      const ends = [centre - Math.hypot(limit.half[0], more) - low, centre + Math.hypot(limit.half[1], more) + high];
      return { value: share(centre), low: share(ends[0]), high: share(ends[1]), kind, same: same && kind === "exact" };
    }

    function sameLaw(limit, setting) {
      const a = setting.limits[limit.name], b = first.limits[limit.name];
      return a.mean === b.mean && !a.scatter && a.spearman === b.spearman;
    }

    // what a law is moved by: Weibull's modulus, else the coefficient of variation
    const scatterOf = ({ law }) => law.kind === "weibull" ? law.m : Math.sqrt(Math.expm1(law.sd * law.sd));
    const met = (found, target) => found.high < target ? true : found.low > target ? false : null;

    // the verdict: the study's own where nothing moved, else by what rows can judge again
    function verdict(limit, setting, found) {
      const target = setting.limits[limit.name].target;
      if (target === null || target === undefined) return null;
      const same = found.same && setting.ways.size === 0 &&
        limit.together.every(name => sameLaw(data.limits.find(l => l.name === name) || limit, setting));
      if (same) return { word: limit.word, reasons: limit.reasons.slice(0, 3) };
      const reasons = limit.stays.map(text => text + ", in the study"), n = some.n;
      let base = found, before = own(some, limit, setting, 0).chance;
      const others = data.limits.filter(l => limit.together.includes(l.name));
      if (others.length) {
        const all = Float64Array.from(before);
        for (const one of others) {
          const x = demand(some, one, setting.at);
          const c = missed(some, one, setting, x, one.law, change(one, setting), rhoOf(one, setting), limit.aim).chance;
          for (let i = 0; i < n; i++) all[i] += (1 - all[i]) * c[i];
        }
        let gain = 0;
        for (let i = 0; i < n; i++) gain += (all[i] - before[i]) / n;
        base = { value: found.value + gain, low: found.low + gain, high: found.high + gain };
        before = all;
      }
      const now = met(base, target), turning = [], most = [];
      const lifted = chance => {
        let gain = 0;
        for (let i = 0; i < n; i++) gain += (1 - before[i]) * chance[i] / n;
        return { low: base.low + gain, high: base.high + gain };
      };
      for (const way of limit.ways) {
        if (setting.ways.has(way.name)) continue;
        const x = surfaceOf(some, way.quantity, setting.at);
        const chances = [0, 1, 2].map(k => wayChance(some, limit, way, setting, k, x));
        if (chances.some(c => met(lifted(c.chance), target) !== now)) turning.push(way.name);
        most.push(chances.reduce((a, b) => mean(a.event) > mean(b.event) ? a : b).chance);
      }
      if (turning.length) reasons.push("it turns on " + turning.join(" and ") + ", with strengths assumed from the library");
      else if (most.length > 1) {
        const all = new Float64Array(n);
        for (const c of most) for (let i = 0; i < n; i++) all[i] += (1 - all[i]) * c[i];
        if (met(lifted(all), target) !== now) reasons.push("it turns on all ways with assumed strengths together");
      }
      if (reasons.length) return { word: "not established", reasons: reasons.slice(0, 3) };
      if (now === null) return { word: "undecided", reasons: ["the interval holds the target"] };
      return { word: now ? "met" : "not met", reasons: [] };
    }

    // the share broken over a slider by the limit and by the assumed ways; ways follow the scene alone, and are kept
    let kept = { key: "" };

    function curve(limit, setting, path, count) {
      const one = sliders.get(path), breaks = p => limit.aim === "survive" ? p : 1 - p;
      const x = Array.from({ length: count }, (_, k) => one.low * (one.high / one.low) ** (k / (count - 1)));
      const settings = x.map(value => ({ ...setting, at: { ...setting.at, [path]: value } }));
      const line = settings.map(at => breaks(share(logits(own(few, limit, at, 0))[0] + limit.off.get(few)[0])));
      const key = JSON.stringify([limit.name, path, { ...setting.at, [path]: 0 }]);
      if (kept.key !== key) {
        kept = { key, ways: limit.ways.map(way => settings.filter((_, k) => k % 2 === 0).map(at => breaks(mean(wayChance(few, limit, way, at, 1).chance)))) };
      }
      return { x, own: line, ways: kept.ways };
    }

    function crossing(drawn, level) {
      const { x } = drawn, s = drawn.own.map(score), wanted = score(level);
      for (let k = 1; k < x.length; k++)
        if ((s[k - 1] - wanted) * (s[k] - wanted) <= 0 && s[k] !== s[k - 1])
          return x[k - 1] * Math.pow(x[k] / x[k - 1], (wanted - s[k - 1]) / (s[k] - s[k - 1]));
      return null;
    }

    return { data, start, answer, verdict, curve, crossing, sliders, score, scatterOf };
  }

  if (typeof module !== "undefined") module.exports = { makeModel };
  if (typeof document === "undefined") return;

  // --- the panel -------------------------------------------------------------------------------------------------

  const NARROW = "\u00a0", TICKS = [0.001, 0.01, 0.1, 0.5, 0.9, 0.99], BOX = { w: 560, h: 300, l: 44, r: 556, t: 14, b: 262 };
  const probe = document.createElement("template");
  probe.innerHTML = "<svg></svg>";
  const SVG = probe.content.firstChild.namespaceURI;
  let panels = 0;

  function element(tag, attributes, ...children) {
    const svg = ["svg", "path", "line", "text", "circle", "title"].includes(tag);
    const out = svg ? document.createElementNS(SVG, tag) : document.createElement(tag);
    for (const name in attributes) out.setAttribute(name, attributes[name]);
    out.append(...children);
    return out;
  }

  function two(v, digits = 2) {
    if (v === 0 || !isFinite(v)) return String(v);
    const shown = Number(v.toPrecision(digits)), places = digits - 1 - Math.floor(Math.log10(Math.abs(shown)));
    return shown.toFixed(Math.min(Math.max(places, 0), 20));
  }

  function percent(p, target) { // the rules of the brief
    if (p < 1e-3) return p > 0 ? "under 0.1" + NARROW + "%" : "0" + NARROW + "%";
    if (p > 0.999) return "over 99.9" + NARROW + "%";
    const text = two(100 * p), alike = target && text === two(100 * target) && Math.abs(p - target) > 1e-9 * target;
    return (alike ? two(100 * p, 3) : text) + NARROW + "%";
  }

  const fine = p => p < 1e-6 ? "0" : two(100 * p, 3);
  const plain = v => String(Number(v.toPrecision(6)));

  function build(section) {
    const model = makeModel(JSON.parse(section.querySelector("script").textContent)), { data } = model;
    const id = name => "whatif" + number + "-" + name, number = ++panels;
    let setting = model.start(), limit = data.limits[0], due = false, spoken = 0, trusted = 1;
    const controls = [];

    const settings = element("div", { class: "settings" }), show = element("div", { class: "shown" });
    const big = element("p", { class: "big" }), what = element("p", { class: "soft" }), interval = element("p", { class: "soft" });
    const second = element("p", {}), light = element("div", { class: "light", role: "img" }), reason = element("p", { class: "reason" });
    const command = element("pre", { hidden: "" }), code = element("code", {}), live = element("p", { class: "unseen", "aria-live": "polite" });
    command.append(code);
    const lamps = [["not met", "×"], ["not established", "?"], ["met", "✓"]].map(([word, mark]) =>
      element("span", { class: "lamp " + word.replace(" ", "-") }, element("i", {}, mark), word[0].toUpperCase() + word.slice(1)));
    light.append(...lamps);
    const path = () => limit.solve && model.sliders.has(limit.solve) ? limit.solve : data.sliders.length ? data.sliders[0].path : "";
    const drawing = element("svg", { viewBox: `0 0 ${BOX.w} ${BOX.h}`, role: "img", "aria-labelledby": id("title") });
    const lines = element("path", { class: "curve contact", "stroke-width": 2.4 }), old = element("path", { class: "curve study" });
    const band = element("path", { class: "band" }), mark = element("line", { class: "plan", y1: BOX.t, y2: BOX.b });
    const goal = element("line", { class: "target", x1: BOX.l, x2: BOX.r, "stroke-dasharray": "1.5 3" });
    const ways = [], names = [];

    // --- sliders: one input for the hand and one for the number, both of the same value

    function control(name, label, kind, ends, cover, unit, factor, get, set, logarithmic) {
      const places = 1000, span = logarithmic ? Math.log(ends[1] / ends[0]) : ends[1] - ends[0];
      const part = v => logarithmic ? Math.log(v / ends[0]) / span : (v - ends[0]) / span;
      const value = x => logarithmic ? ends[0] * Math.exp(x * span) : ends[0] + x * span;
      const range = element("input", { type: "range", min: 0, max: places, step: 1, id: id(name), class: kind });
      const field = element("input", { type: "number", step: "any", "aria-label": label + (unit ? ", " + unit : "") });
      const at = p => (100 * Math.min(Math.max(p, 0), 1)).toFixed(2) + "%";
      range.style.setProperty("--from", at(part(cover[0])));
      range.style.setProperty("--to", at(part(cover[1])));
      range.style.setProperty("--study", at(part(get(model.start()))));
      const read = () => {
        range.value = Math.round(places * part(get(setting)));
        if (document.activeElement !== field) field.value = plain(Number((get(setting) * factor).toPrecision(4)));
        range.setAttribute("aria-valuetext", plain(Number((get(setting) * factor).toPrecision(3))) + " " + unit);
      };
      range.addEventListener("input", () => {
        const study = get(model.start()), next = value(range.value / places);
        set(Math.abs(range.value / places - part(study)) < 0.004 ? study : Number(next.toPrecision(4)));
        change();
      });
      field.addEventListener("input", () => {
        const next = Number(field.value) / factor;
        if (field.value !== "" && isFinite(next) && (next > 0 || !logarithmic)) { set(next); change(); }
      });
      field.addEventListener("change", read);
      controls.push(read);
      return element("div", { class: "control" }, element("label", { for: id(name) }, label), element("span", { class: "tag" }, kind),
        element("span", { class: "field" }, field, " " + unit), range);
    }

    function strengthControls() {
      const own = s => s.limits[limit.name], found = [], mean = limit.mean, { law } = limit;
      found.push(control("mean", law.kind === "fixed" ? "Strength" : "Mean strength", "exact", [mean / 2, mean * 2], [mean / 2, mean * 2],
        limit.unit, limit.factor, s => own(s).mean, v => { own(setting).mean = v; }, true));
      if (law.kind === "weibull" && !law.threshold || law.kind === "lognormal") {
        const base = model.scatterOf(limit), ends = [base / 3, base * 3];
        found.push(control("scatter", law.kind === "weibull" ? "Weibull modulus" : "Scatter of strength", "exact", ends, ends, "", 1,
          s => own(s).scatter || base, v => { own(setting).scatter = v === base ? 0 : v; }, true));
      }
      if (limit.tie) {
        found.push(control("tie", `Correlation with ${limit.tie.label}`, "exact", [-0.95, 0.95], [-0.95, 0.95], "", 1,
          s => own(s).spearman, v => { own(setting).spearman = Math.min(Math.max(v, -0.99), 0.99); }, false));
      }
      if (limit.target) {
        found.push(control("target", "Target", "exact", [1e-4, 0.5], [1e-4, 0.5], "%", 100, s => own(s).target,
          v => { own(setting).target = Math.min(Math.max(v, 1e-9), 0.999); }, true));
      }
      return found;
    }

    function physicalControls() {
      return data.sliders.filter(() => data.surfaces[limit.quantity]).map(one => {
        const wide = Math.sqrt(one.high / one.low);
        return control(one.path, one.label, "estimate", [one.low / wide ** 0.4, one.high * wide ** 0.4], [one.low, one.high], one.unit,
          one.factor, s => s.at[one.path], v => { setting.at[one.path] = v; }, true);
      });
    }

    function fill() { // the sliders of a limit
      controls.length = 0;
      settings.replaceChildren(element("h2", { id: id("head") }, "What if?" + (data.service ? " " + data.service : "")),
        element("p", { class: "small" }, "Blue: covered by stored runs. Hatched: run it. Tick: the study."));
      if (data.limits.length > 1) {
        const choice = element("select", { id: id("limit") }, ...data.limits.map(l => element("option", { value: l.name }, l.title)));
        choice.value = limit.name;
        choice.addEventListener("change", () => { limit = data.limits.find(l => l.name === choice.value); fill(); change(); });
        settings.append(element("p", {}, element("label", { for: id("limit") }, "Limit "), choice));
      }
      settings.append(...strengthControls(), ...physicalControls());
      const lacking = data.surfaces[limit.quantity] ? "" : data.absent;
      if (lacking) settings.append(element("p", { class: "small" }, `Speeds and sizes: ${lacking}.`));
      if (limit.ways.length) {
        const boxes = limit.ways.map((way, k) => {
          const box = element("input", { type: "checkbox", id: id("way" + k) });
          box.checked = true;
          box.addEventListener("change", () => { setting.ways[box.checked ? "delete" : "add"](way.name); change(); });
          controls.push(() => { box.checked = !setting.ways.has(way.name); });
          return element("span", { class: "way" }, box, element("label", { for: id("way" + k) }, way.name));
        });
        settings.append(element("p", { class: "small" }, `Count as fracture, beside ${limit.label.toLowerCase()}`), element("p", {}, ...boxes));
      }
      const back = element("button", { type: "button" }, "Back to the study");
      back.addEventListener("click", () => { setting = model.start(); change(); });
      settings.append(back);
      axes();
    }

    // --- the drawing: probability paper over the number that is solved for, or the load

    const low = model.score(0.0005), high = model.score(0.995);
    const across = v => { const one = model.sliders.get(path()); return BOX.l + (BOX.r - BOX.l) * Math.log(v / one.low) / Math.log(one.high / one.low); };
    const up = p => BOX.b - (BOX.b - BOX.t) * (model.score(Math.min(Math.max(p, 1e-9), 1 - 1e-9)) - low) / (high - low);
    const inside = p => p > 0.0005 && p < 0.995;

    function axes() {
      drawing.replaceChildren();
      ways.length = names.length = 0;
      drawing.style.display = path() && data.surfaces[limit.quantity] ? "" : "none";
      if (!path()) return;
      const one = model.sliders.get(path());
      drawing.append(element("title", { id: id("title") }, "Share broken over " + one.label.toLowerCase()));
      for (const p of TICKS) {
        drawing.append(element("line", { class: "grid", x1: BOX.l, x2: BOX.r, y1: up(p), y2: up(p) }),
          element("text", { class: "soft", x: BOX.l - 5, y: up(p) + 4, "text-anchor": "end" }, plain(100 * p)));
      }
      drawing.append(element("line", { class: "axis", x1: BOX.l, x2: BOX.r, y1: BOX.b, y2: BOX.b }));
      const decade = 10 ** Math.floor(Math.log10(one.low * one.factor)), steps = [1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50, 70];
      for (const m of steps.map(k => k * decade).filter(v => v >= one.low * one.factor * 0.999 && v <= one.high * one.factor * 1.001)) {
        const x = across(m / one.factor);
        drawing.append(element("line", { class: "axis", x1: x, x2: x, y1: BOX.b, y2: BOX.b + 4 }),
          element("text", { class: "soft", x, y: BOX.b + 18, "text-anchor": "middle" }, plain(m)));
      }
      drawing.append(element("text", { x: BOX.r, y: BOX.b + 35, "text-anchor": "end" }, `${one.label.toLowerCase()}, ${one.unit}; share broken, %`));
      drawing.append(band, old, goal, mark);
      for (const way of limit.ways) {
        const kind = way.name.includes("core") ? "core" : way.name.includes("energy") ? "energy" : "other";
        const line = element("path", { class: "curve " + kind, "stroke-width": 1.8, "stroke-dasharray": { core: "8 4", energy: "9 3 2 3", other: "3 3" }[kind] });
        const text = element("text", { class: "halo soft" }, way.name);
        ways.push(line);
        names.push(text);
        drawing.append(line, text);
      }
      const own = element("text", { class: "halo strong contact" }, limit.label.toLowerCase());
      names.push(own);
      drawing.append(lines, own);
      const first = model.start(), study = model.curve(limit, first, path(), 17), target = first.limits[limit.name].target;
      old.setAttribute("d", draw(study));
      const start = target ? model.crossing(study, limit.aim === "survive" ? target : 1 - target) : null;
      // the run knows its own answer better
      trusted = limit.solve === path() && limit.solved && start ? limit.solved / start : 1;
    }

    function draw(curve, values = curve.own) {
      const x = values.length === curve.x.length ? curve.x : curve.x.filter((_, k) => k % 2 === 0);
      return values.map((p, k) => inside(p) ? [across(x[k]).toFixed(1), up(p).toFixed(1)] : null)
        .reduce((text, point) => point ? text + (text ? "L" : "M") + point.join(" ") : text, "");
    }

    function name(text, d) { // beside the curve, two thirds of its way
      const points = d.slice(1).split("L"), point = points[Math.floor(points.length * 0.66)] || "";
      const [x, y] = point.split(" ").map(Number);
      text.style.display = d ? "" : "none";
      if (d) { text.setAttribute("x", x < 400 ? x + 7 : x - 7); text.setAttribute("text-anchor", x < 400 ? "start" : "end"); text.setAttribute("y", y + 14); }
    }

    // --- one move

    function commands() { // what would be run for this setting
      const first = model.start(), own = setting.limits[limit.name], before = first.limits[limit.name], set = [];
      for (const one of data.sliders) {
        if (setting.at[one.path] === first.at[one.path]) continue;
        const number = ratio => `"${plain(setting.at[one.path] * ratio * one.factor)} ${one.file_unit}"`;
        set.push(`${one.set}=${number(1)}`, ...Object.entries(one.cut).map(([key, ratio]) => `${one.key}.${key}=${number(ratio)}`));
      }
      const strength = `limits.${limit.name}.strength`, { kind } = limit.law, mean = `"${plain(own.mean * limit.factor)} ${limit.file_unit}"`;
      if (own.mean !== before.mean || own.scatter) {
        const key = kind === "weibull" ? "modulus" : "cov", scatter = plain(own.scatter || model.scatterOf(limit));
        set.push(kind === "fixed" ? `${strength}=${mean}` : kind === "table" ? `${strength}.mean=${mean}` :
          `${strength}={ dist = "${kind}", mean = ${mean}, ${key} = ${scatter} }`);
      }
      if (own.spearman !== before.spearman) {
        set.push(`dependence=[{ of = ["${limit.tie.with}", "${strength}"], spearman = ${plain(own.spearman)} }]`);
      }
      if (own.target !== before.target) set.push(`limits.${limit.name}.target=${plain(own.target)}`);
      return "uqsphere run study.toml" + set.map(text => ` --set '${text}'`).join("");
    }

    function update() {
      due = false;
      controls.forEach(read => read());
      const found = model.answer(limit, setting), own = setting.limits[limit.name];
      const survive = limit.aim === "survive";
      what.textContent = `Share ${survive ? "broken" : "left whole"}, ${limit.label.toLowerCase()}`;
      const verdict = found && model.verdict(limit, setting, found);
      lamps.forEach(lamp => {
        const word = verdict ? (verdict.word === "undecided" ? "not established" : verdict.word) : "";
        lamp.classList.toggle("on", lamp.classList.contains(word.replace(" ", "-")));
      });
      light.setAttribute("aria-label", verdict ? "Verdict: " + verdict.word : "No verdict");
      light.style.display = limit.target ? "" : "none";
      reason.textContent = verdict ? verdict.reasons.map(text => text[0].toUpperCase() + text.slice(1) + ".").join(" ") : "";
      section.classList.toggle("grey", !found);
      command.hidden = !!found;
      second.textContent = "";
      if (!found) {
        big.textContent = "no answer";
        interval.textContent = "No stored run covers this setting. Run it:";
        code.textContent = commands();
      } else {
        big.textContent = percent(found.value, own.target);
        interval.textContent = `${found.kind === "exact" ? "Exact from rows" : "Estimate"}: ` +
          (found.high < 1e-6 ? "at most 0.0001" : `${fine(found.low)} to ${fine(found.high)}`) + NARROW + "%";
      }
      if (path() && data.surfaces[limit.quantity]) {
        const one = model.sliders.get(path()), shown = found ? model.curve(limit, setting, path(), 17) : null, d = shown ? draw(shown) : "";
        lines.setAttribute("d", d);
        names.forEach((text, k) => {
          const line = k < ways.length ? (shown && !setting.ways.has(limit.ways[k].name) ? draw(shown, shown.ways[k]) : "") : d;
          if (k < ways.length) ways[k].setAttribute("d", line);
          name(text, line);
        });
        const x = across(Math.min(Math.max(setting.at[path()], one.low), one.high)), level = survive ? own.target : 1 - own.target;
        mark.setAttribute("x1", x);
        mark.setAttribute("x2", x);
        goal.style.display = own.target && inside(level) ? "" : "none";
        goal.setAttribute("y1", up(level));
        goal.setAttribute("y2", up(level));
        const places = shown && found.kind === "estimate" ? [found.low, found.high] : null;
        band.setAttribute("d", places ? `M${x - 4} ${up(survive ? places[0] : 1 - places[0])}h8V${up(survive ? places[1] : 1 - places[1])}h-8Z` : "");
        const now = own.target && shown ? model.crossing(shown, level) : null;
        if (own.target && shown) second.textContent = `${one.label} at the target: ${now ? two(now * trusted * one.factor) + NARROW + one.unit : "beyond the stored runs"}`;
      }
      clearTimeout(spoken);
      spoken = setTimeout(() => { live.textContent = `${what.textContent}: ${big.textContent}. ${verdict ? "Verdict: " + verdict.word : ""}`; }, 500);
    }

    function change() {
      if (!due) { due = true; requestAnimationFrame(update); }
    }

    const head = element("div", { class: "result" }, element("div", {}, what, big, interval, second), element("div", {}, light, reason));
    show.append(head, command, drawing, live);
    section.append(settings, show);
    section.setAttribute("aria-labelledby", id("head"));
    section.hidden = false;
    fill();
    update();
    return { move: (key, value) => { setting.at[key] = value; }, update };
  }

  root.uqsphereWhatIf = { makeModel, panels: [...document.querySelectorAll("section.whatif")].map(build) };
})(typeof globalThis === "undefined" ? this : globalThis);
