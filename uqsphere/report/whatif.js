"use strict";
// What if: the rows of a run asked again for other strengths, targets, speeds and sizes.  Units are SI, demands in ln.
(function (root) {
  // --- numbers ---------------------------------------------------------------------------------------------------

  function lnGamma(x) { // Lanczos, g = 7, nine terms
    const c = [0.99999999999980993, 676.5203681218851, -1259.1392167224028, 771.32342877765313, -176.61502916214059,
      12.507343278686905, -0.13857109526572012, 9.9843695780195716e-6, 1.5056327351493116e-7];
    const sum = c.reduce((total, one, k) => total + one / (x - 1 + k));
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

  const logit = (p, q) => Math.log(p) - Math.log(q), share = l => 1 / (1 + Math.exp(-l));
  const mean = list => list.reduce((a, b) => a + b, 0) / list.length;
  const either = (a, b) => a.map((p, i) => p + (1 - p) * b[i]); // chances, row by row, that one of two things happens
  const clip = (x, low, high) => Math.min(Math.max(x, low), high);
  // 97.5 % of Student's law with 1 to 15 degrees of freedom
  const STUDENT = [12.71, 4.3, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.2, 2.18, 2.16, 2.14, 2.131];

  function between(nodes, values, x) { // straight lines between places in ln
    let k = 1;
    while (k < nodes.length - 1 && nodes[k] < x) k++;
    const part = Math.log(x / nodes[k - 1]) / Math.log(nodes[k] / nodes[k - 1]);
    return values[k - 1] + part * (values[k] - values[k - 1]);
  }

  function unpacked([low, step, text]) {
    const raw = atob(text);
    return Float64Array.from({ length: raw.length / 2 }, (_, i) => low + step * (raw.charCodeAt(2 * i) | (raw.charCodeAt(2 * i + 1) << 8)));
  }

  function told({ from, step, scores }, x) { // a function that is known at even steps
    const at = clip((x - from) / step, 0, scores.length - 1.001), k = Math.floor(at);
    return scores[k] + (at - k) * (scores[k + 1] - scores[k]);
  }

  // normal scores of a Weibull law over ln H, H = ((s - threshold)/scale)^modulus
  const WEIBULL = { from: -80, step: 0.05, scores: Array.from({ length: 1691 }, (_, k) => {
    const h = Math.exp(-80 + 0.05 * k);
    return h < 0.7 ? score(-Math.expm1(-h)) : -score(Math.exp(-h));
  }) };

  // --- rows: columns of the sample, and the products of powers of what scatters in them ---------------------------

  function makeRows(parts, sizes) { // the first rows of every randomisation; parts: [columns, how many rows each has]
    const own = {}, powers = new Map(), n = sizes.reduce((a, b) => a + b, 0);
    for (const [columns, counts] of parts) {
      const kept = [];
      counts.reduce((first, count, r) => { for (let i = 0; i < sizes[r]; i++) kept.push(first + i); return first + count; }, 0);
      for (const name in columns) own[name] = Float64Array.from(kept, i => columns[name][i]);
    }
    function product(key, names) { // of the columns `names` to the powers in the digits of a number, eight to a place
      if (!powers.has(key)) {
        const out = new Float64Array(n).fill(1);
        for (let k = 0, rest = key; rest > 0; k++, rest = Math.floor(rest / 8))
          for (let p = 0; p < rest % 8; p++) for (let i = 0; i < n; i++) out[i] *= own[names[k]][i];
        powers.set(key, out);
      }
      return powers.get(key);
    }
    return { sizes, n, columns: own, product };
  }

  // --- the model: everything that the rows can be asked ------------------------------------------------------------

  function makeModel(data) {
    const unpack = packed => Object.fromEntries(Object.entries(packed).map(([name, column]) => [name, unpacked(column)]));
    const asked = [unpack(data.asked), data.counts], columns = unpack(data.moved), parts = [asked, [columns, data.few]];
    const atMost = most => data.few.map(n => Math.min(n, Math.ceil(most / data.few.length)));
    // for answers that nothing but the strength moves; for others; for verdicts; for every point of a curve
    const every = makeRows([asked], data.counts), many = makeRows(parts, data.few);
    const some = makeRows(parts, atMost(1024)), few = makeRows(parts, atMost(256));
    const names = data.axes.map(a => a[0]), sliders = new Map(data.sliders.map(s => [s.path, s])), BASE = 8;
    const reach = key => { let out = 1; for (; key > 0; key = Math.floor(key / BASE)) out *= 3 ** (key % BASE); return out; };

    // a surface at a setting: coefficients by what is left of a row, the powers of its columns as one number
    function terms(quantity, at) {
      const { p, c, error } = data.surfaces[quantity], found = new Map();
      const powersOf = data.axes.map(([name, middle, half]) => {
        const one = sliders.get(name), random = columns[name] !== undefined;
        const a = ((one ? between(one.nodes, one.centres, at[name]) : middle) - middle) / half;
        const b = random ? (one ? between(one.nodes, one.spreads, at[name]) / half : 1) : 0, rows = [[1]];
        for (let n = 1; n < BASE; n++) // (a + b u)^n by powers of u; what no row feels is left out
          rows.push(Array.from({ length: random ? n + 1 : 1 }, (_, k) => a * (rows[n - 1][k] || 0) + (k ? b * rows[n - 1][k - 1] : 0)));
        return rows;
      });
      for (let t = 0; t < c.length; t++) {
        const keys = [0], values = [c[t]];
        for (let k = 0, place = 1; k < p[t].length; k++, place *= BASE) {
          if (p[t][k] === "0") continue;
          const factors = powersOf[k][p[t][k]];
          for (let m = keys.length - 1; m >= 0; m--) {
            const value = values[m];
            values[m] = value * factors[0];
            for (let n = 1; n < factors.length; n++)
              if (Math.abs(value * factors[n]) * 3 ** n > 1e-4 * error) { keys.push(keys[m] + n * place); values.push(value * factors[n]); }
          }
        }
        for (let m = 0; m < keys.length; m++) found.set(keys[m], (found.get(keys[m]) || 0) + values[m]);
      }
      for (const [key, value] of found) if (Math.abs(value) * reach(key) < 0.01 * error) found.delete(key);
      return found;
    }

    const still = Object.fromEntries(data.sliders.map(s => [s.path, s.base])), base = {};
    for (const q in data.surfaces) base[q] = terms(q, still);
    const moved = at => data.sliders.some(s => Math.abs(at[s.path] / s.base - 1) > 1e-9);
    const covered = at => data.sliders.every(s => at[s.path] >= s.low * (1 - 1e-9) && at[s.path] <= s.high * (1 + 1e-9));

    function add(rows, out, found) {
      for (const [key, c] of found) {
        const product = rows.product(key, names);
        for (let i = 0; i < out.length; i++) out[i] += c * product[i];
      }
      return out;
    }

    function demand(rows, limit, at, offset = 0) { // ln demand: a row's own, moved by what the surface moves by
      const out = rows.columns["demand " + limit.name].map(v => v + offset);
      if (!data.surfaces[limit.quantity] || !moved(at)) return out;
      const found = terms(limit.quantity, at);
      for (const [key, c] of base[limit.quantity]) found.set(key, (found.get(key) || 0) - c);
      return add(rows, out, found);
    }

    const surface = (rows, quantity, at) => add(rows, new Float64Array(rows.n), moved(at) ? terms(quantity, at) : base[quantity]);

    // a function of ln demand and of the score that ties the strength: shares (below, above) into a pair
    function shares(law, { ratio, scatter }, rho) {
      const rest = Math.sqrt(1 - rho * rho);
      const scored = (s, z, pair) => { const u = (s - rho * z) / rest; pair[0] = below(u); pair[1] = below(-u); };
      if (law.kind === "fixed") return (x, z, pair) => { pair[0] = x > law.ln + ratio ? 1 : 0; pair[1] = 1 - pair[0]; };
      if (law.kind === "table") return (x, z, pair) => scored(told(law, x - ratio), z, pair);
      if (law.kind === "lognormal") {
        const sd = scatter ? Math.sqrt(Math.log1p(scatter * scatter)) : law.sd, centre = law.mu + 0.5 * law.sd * law.sd + ratio;
        return (x, z, pair) => scored((x - centre + 0.5 * sd * sd) / sd, z, pair);
      }
      const m = scatter || law.m, scale = Math.log(law.scale) + lnGamma(1 + 1 / law.m) - lnGamma(1 + 1 / m);
      const hazard = x => { // its logarithm
        if (!law.threshold) return m * (x - ratio - scale);
        const over = Math.exp(x - ratio) - law.threshold;
        return over > 0 ? m * (Math.log(over) - scale) : WEIBULL.from;
      };
      if (rho) return (x, z, pair) => scored(told(WEIBULL, hazard(x)), z, pair);
      return (x, z, pair) => { const h = Math.exp(hazard(x)); pair[0] = -Math.expm1(-h); pair[1] = Math.exp(-h); };
    }

    // chances of a miss, each row's, and means of a miss and of none over every randomisation, for an interval
    function missed(rows, x, law, change, aim, tie, rho) {
      const f = shares(law, change, rho), z = tie ? rows.columns["score " + tie.with] : null, by = aim === "survive" ? 0 : 1;
      const chance = new Float64Array(rows.n), pair = [0, 0], event = [], other = [];
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

    function logits(found) { // value and half-width of the 95 % interval, from the randomisations
      const p = mean(found.event), q = mean(found.other), small = p < q ? found.event : found.other, m = mean(small);
      if (!(p > 0 && q > 0)) return [p > 0 ? 38 : -38, 0];
      const r = small.length, sd = Math.sqrt(small.reduce((s, v) => s + (v - m) * (v - m), 0) / Math.max(r - 1, 1));
      const half = r > 1 ? STUDENT[Math.min(r - 2, 14)] * sd / Math.sqrt(r) / (p * q) : 0;
      return [logit(p, q), Math.min(half, 600)];
    }

    function own(rows, limit, setting, offset = 0, aim = limit.aim) { // misses of a limit itself
      const { mean, scatter, spearman } = setting.limits[limit.name], rho = limit.tie ? 2 * Math.sin(Math.PI * spearman / 6) : 0;
      const x = demand(rows, limit, setting.at, offset);
      return missed(rows, x, limit.law, { ratio: Math.log(mean / limit.mean), scatter }, aim, limit.tie, rho);
    }

    // misses by a way of breaking with one of the library's strengths; `x` are its ln demands
    function assumed(rows, limit, way, setting, law, x = surface(rows, way.quantity, setting.at)) {
      let ratio = 0;
      for (const name in way.scales) ratio += between(sliders.get(name).nodes, way.scales[name], setting.at[name]);
      const { chance, event } = missed(rows, x, law, { ratio, scatter: 0 }, limit.aim, null, 0);
      if (!way.offset) return { chance, event };
      const lifted = chance.map(p => clip(p, 1e-300, 1 - 1e-16)).map(p => share(logit(p, 1 - p) + way.offset));
      return { chance: lifted, event };
    }

    function start() { // the study as it is
      const limits = data.limits.map(l => [l.name, { mean: l.mean, scatter: 0, spearman: l.tie ? l.tie.spearman : 0, target: l.target }]);
      return { at: { ...still }, limits: Object.fromEntries(limits), ways: new Set() };
    }

    const first = start(), sameLaw = (limit, setting) =>
      ["mean", "scatter", "spearman"].every(key => setting.limits[limit.name][key] === first.limits[limit.name][key]);
    for (const limit of data.limits) { // how far the rows are from what the run knows better
      const [value, low, high] = limit.miss, known = logit(value, 1 - value);
      limit.off = new Map([every, many, some, few].map(rows => {
        const [found, half] = logits(own(rows, limit, first));
        return [rows, Math.abs(found) < 38 && isFinite(known) ? [known - found, half] : [0, half]];
      }));
      const ends = isFinite(known) ? [known - logit(Math.max(low, 1e-300), 1 - low), logit(Math.min(high, 1 - 1e-16), 1 - high) - known] : [0, 0];
      limit.half = ends.map(h => isFinite(h) ? Math.min(h, 600) : 600);
      for (const way of limit.ways) {
        const p = mean(assumed(some, limit, way, first, way.laws[1]).event);
        way.offset = p > 0 && p < 1 && way.miss > 0 && way.miss < 1 ? logit(way.miss, 1 - way.miss) - logit(p, 1 - p) : 0;
      }
    }

    // the probability that a limit misses its aim, with its interval: exact from rows, or an estimate; null where unknown
    function answer(limit, setting) {
      const kind = moved(setting.at) ? "estimate" : "exact", rows = kind === "exact" ? every : many;
      if (!covered(setting.at) || kind === "estimate" && !data.surfaces[limit.quantity]) return null;
      const [value, half] = logits(own(rows, limit, setting)), [offset, baseHalf] = limit.off.get(rows);
      const error = kind === "exact" ? 0 : data.surfaces[limit.quantity].error, same = kind === "exact" && sameLaw(limit, setting);
      const by = [-error, error].map(e => e ? logits(own(rows, limit, setting, e))[0] - value : 0);
      const more = same ? 0 : Math.hypot(half, baseHalf), centre = value + offset;
      const low = centre - Math.hypot(limit.half[0], more) + Math.min(...by), high = centre + Math.hypot(limit.half[1], more) + Math.max(...by);
      const untouched = same && setting.limits[limit.name].target === first.limits[limit.name].target;
      return { value: share(centre), low: share(low), high: share(high), kind, same: untouched };
    }

    const met = (found, target) => found.high < target ? true : found.low > target ? false : null;
    // the verdict: the study's own where nothing moved, else by what rows can judge again
    function verdict(limit, setting, found) {
      const { target } = setting.limits[limit.name], others = data.limits.filter(l => limit.together.includes(l.name));
      if (target === null || target === undefined) return null;
      if (found.same && !setting.ways.size && others.every(one => sameLaw(one, setting))) return { word: limit.word, reasons: limit.reasons.slice(0, 3) };
      const alone = own(some, limit, setting).chance, ways = limit.ways.filter(way => !setting.ways.has(way.name));
      const all = others.reduce((chance, one) => either(chance, own(some, one, setting, 0, limit.aim).chance), alone);
      const judged = chance => { // whether the target is kept with these misses beside the limit's own
        const gain = mean(chance) - mean(alone);
        return met({ low: found.low + gain, high: found.high + gain }, target);
      };
      const now = judged(all), reasons = limit.stays.map(text => text + ", in the study");
      const chances = ways.map(way => {
        const x = surface(some, way.quantity, setting.at);
        return way.laws.map(law => assumed(some, limit, way, setting, law, x));
      });
      const turning = ways.filter((_, k) => chances[k].some(one => judged(either(all, one.chance)) !== now)).map(way => way.name);
      const most = chances.map(laws => laws.reduce((a, b) => mean(a.event) > mean(b.event) ? a : b).chance);
      if (turning.length) reasons.push("it turns on " + turning.join(" and ") + ", with strengths assumed from the library");
      else if (most.length > 1 && judged(most.reduce(either, all)) !== now) reasons.push("it turns on all ways with assumed strengths together");
      if (reasons.length) return { word: "not established", reasons: reasons.slice(0, 3) };
      if (now === null) return { word: "undecided", reasons: ["the interval holds the target"] };
      return { word: now ? "met" : "not met", reasons: [] };
    }

    let kept = { key: "" }; // ways follow the scene alone
    function curve(limit, setting, path, count) { // the share broken over a slider, by the limit and by the assumed ways
      const one = sliders.get(path), breaks = p => limit.aim === "survive" ? p : 1 - p;
      const x = Array.from({ length: count }, (_, k) => one.low * (one.high / one.low) ** (k / (count - 1)));
      const settings = x.map(value => ({ ...setting, at: { ...setting.at, [path]: value } }));
      const line = settings.map(at => breaks(share(logits(own(few, limit, at))[0] + limit.off.get(few)[0])));
      const key = JSON.stringify([limit.name, path, { ...setting.at, [path]: 0 }]), coarse = settings.filter((_, k) => k % 2 === 0);
      if (kept.key !== key) kept = { key, ways: limit.ways.map(way => coarse.map(at => breaks(mean(assumed(few, limit, way, at, way.laws[1]).chance)))) };
      return { x, own: line, ways: kept.ways };
    }

    function crossing({ x, own }, level) {
      const s = own.map(score), wanted = score(level);
      for (let k = 1; k < x.length; k++)
        if ((s[k - 1] - wanted) * (s[k] - wanted) <= 0 && s[k] !== s[k - 1])
          return x[k - 1] * (x[k] / x[k - 1]) ** ((wanted - s[k - 1]) / (s[k] - s[k - 1]));
      return null;
    }

    return { data, start, answer, verdict, curve, crossing, sliders };
  }

  if (typeof module !== "undefined") module.exports = { makeModel };
  if (typeof document === "undefined") return;

  // --- the panel -------------------------------------------------------------------------------------------------

  const GAP = "\u00a0", TICKS = [0.001, 0.01, 0.1, 0.5, 0.9, 0.99], BOX = { w: 560, h: 300, l: 44, r: 556, t: 14, b: 262 };
  const STEPS = [1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50, 70], DASHES = { core: "8 4", energy: "9 3 2 3", other: "3 3" };
  const safe = text => String(text).replace(/[&<>"]/g, c => `&#${c.charCodeAt(0)};`);
  const plain = v => String(Number(v.toPrecision(6)));

  function two(v, digits = 2) {
    if (v === 0 || !isFinite(v)) return String(v);
    const shown = Number(v.toPrecision(digits)), places = digits - 1 - Math.floor(Math.log10(Math.abs(shown)));
    return shown.toFixed(clip(places, 0, 20));
  }

  function percent(p, target) { // the rules of the brief
    if (p < 1e-3) return (p > 0 ? "under 0.1" : "0") + GAP + "%";
    if (p > 0.999) return "over 99.9" + GAP + "%";
    const text = two(100 * p), alike = target && text === two(100 * target) && Math.abs(p - target) > 1e-9 * target;
    return (alike ? two(100 * p, 3) : text) + GAP + "%";
  }

  function made(html) { // the element that a text stands for
    const shell = document.createElement("template");
    shell.innerHTML = html.trim();
    return shell.content.firstChild;
  }

  function build(section, number) {
    const model = makeModel(JSON.parse(section.querySelector("script").textContent)), { data } = model, study = model.start();
    const id = name => `whatif${number}-${name}`, lamps = [["not met", "×"], ["not established", "?"], ["met", "✓"]];
    let setting = model.start(), limit = data.limits[0], due = false, spoken = 0, trusted = 1, controls = [], path = "", solved = null;
    section.append(made(`<div class="settings"></div>`), made(`<div class="shown"><div class="result"><div><p class="soft what"></p>
      <p class="big"></p><p class="soft interval"></p><p class="second"></p></div><div><div class="light" role="img">${lamps.map(([word, sign]) =>
        `<span class="lamp ${word.replace(" ", "-")}"><i>${sign}</i>${word[0].toUpperCase() + word.slice(1)}</span>`).join("")}</div>
      <p class="reason"></p></div></div><pre hidden><code></code></pre>
      <svg viewBox="0 0 ${BOX.w} ${BOX.h}" role="img" aria-labelledby="${id("title")}"></svg><p class="unseen" aria-live="polite"></p></div>`));
    const [settings, what, big, interval, second, light, reason, command, drawing, live] = ["settings", "what", "big", "interval", "second",
      "light", "reason"].map(name => "." + name).concat("pre", "svg", ".unseen").map(name => section.querySelector(name));

    // a slider and a field of one value: get and set it in a setting; `cover` is where there are answers
    function control({ name, label, kind = "exact", ends, cover = ends, unit = "", factor = 1, get, set, even = false }) {
      const span = even ? ends[1] - ends[0] : Math.log(ends[1] / ends[0]);
      const part = v => clip((even ? v - ends[0] : Math.log(v / ends[0])) / span, 0, 1);
      const value = x => even ? ends[0] + x * span : ends[0] * Math.exp(x * span), at = v => (100 * part(v)).toFixed(2) + "%";
      const box = made(`<div class="control"><label for="${id(name)}">${safe(label)}</label><span class="tag">${kind}</span><span class="field">
        <input type="number" step="any" aria-label="${safe(label + (unit && ", " + unit))}"> ${safe(unit)}</span>
        <input type="range" min="0" max="1000" step="1" id="${id(name)}" class="${kind}"
        style="--from: ${at(cover[0])}; --to: ${at(cover[1])}; --study: ${at(get(study))}"></div>`);
      const [field, range] = box.querySelectorAll("input"), shown = digits => plain(Number((get(setting) * factor).toPrecision(digits)));
      range.addEventListener("input", () => {
        const x = range.value / 1000;
        set(Math.abs(x - part(get(study))) < 0.004 ? get(study) : Number(value(x).toPrecision(4)));
        change();
      });
      field.addEventListener("input", () => {
        const next = Number(field.value) / factor;
        if (field.value !== "" && isFinite(next) && (next > 0 || even)) { set(next); change(); }
      });
      const read = () => {
        range.value = Math.round(1000 * part(get(setting)));
        if (document.activeElement !== field) field.value = shown(4);
        range.setAttribute("aria-valuetext", shown(3) + " " + unit);
      };
      field.addEventListener("change", read);
      controls.push(read);
      return box;
    }

    function sliders() { // of the strength, of the target, of the scene
      const { law, tie, unit, factor } = limit, own = s => s.limits[limit.name], around = (v, by) => [v / by, v * by], found = [];
      const weibull = law.kind === "weibull", usual = weibull ? law.m : Math.sqrt(Math.expm1(law.sd ** 2));
      found.push({ name: "mean", label: law.kind === "fixed" ? "Strength" : "Mean strength", ends: around(limit.mean, 2), unit, factor,
        get: s => own(s).mean, set: v => { own(setting).mean = v; } });
      if (weibull && !law.threshold || law.kind === "lognormal") found.push({ name: "scatter", label: weibull ? "Weibull modulus" : "Scatter of strength",
        ends: around(usual, 3), get: s => own(s).scatter || usual, set: v => { own(setting).scatter = v === usual ? 0 : v; } });
      if (tie) found.push({ name: "tie", label: "Correlation with " + tie.label, ends: [-0.95, 0.95], even: true,
        get: s => own(s).spearman, set: v => { own(setting).spearman = clip(v, -0.99, 0.99); } });
      if (limit.target) found.push({ name: "target", label: "Target", ends: [1e-4, 0.5], unit: "%", factor: 100,
        get: s => own(s).target, set: v => { own(setting).target = clip(v, 1e-9, 0.999); } });
      for (const { path, label, low, high, unit, factor } of data.surfaces[limit.quantity] ? data.sliders : []) {
        const wide = (high / low) ** 0.2;
        found.push({ name: path, label, kind: "estimate", ends: [low / wide, high * wide], cover: [low, high], unit, factor,
          get: s => s.at[path], set: v => { setting.at[path] = v; } });
      }
      return found.map(control);
    }

    function fill() { // the settings of a limit, and its drawing
      controls = [];
      settings.replaceChildren(made(`<h2 id="${id("head")}">What if? ${safe(data.service)}</h2>`),
        made(`<p class="small">Blue: covered by stored runs. Hatched: run it. Tick: the study.</p>`));
      if (data.limits.length > 1) {
        const choice = made(`<p><label for="${id("limit")}">Limit </label><select id="${id("limit")}">${data.limits.map(l =>
          `<option value="${safe(l.name)}"${l === limit ? " selected" : ""}>${safe(l.title)}</option>`).join("")}</select></p>`);
        choice.lastChild.addEventListener("change", event => { limit = data.limits[event.target.selectedIndex]; fill(); change(); });
        settings.append(choice);
      }
      settings.append(...sliders());
      if (!data.surfaces[limit.quantity] && data.absent) settings.append(made(`<p class="small">Speeds and sizes: ${safe(data.absent)}.</p>`));
      if (limit.ways.length) settings.append(made(`<p class="small">Count as fracture, beside ${safe(limit.label.toLowerCase())}</p>`));
      limit.ways.forEach((way, k) => {
        const tick = made(`<span class="way"><input type="checkbox" checked id="${id("way" + k)}"><label for="${id("way" + k)}">${safe(way.name)}</label></span>`);
        tick.firstChild.addEventListener("change", event => { setting.ways[event.target.checked ? "delete" : "add"](way.name); change(); });
        controls.push(() => { tick.firstChild.checked = !setting.ways.has(way.name); });
        settings.append(tick);
      });
      const back = made(`<p><button type="button">Back to the study</button></p>`);
      back.firstChild.addEventListener("click", () => { setting = model.start(); change(); });
      settings.append(back);
      frame();
    }

    // --- the drawing: probability paper over the number that is solved for, or the first that can be moved

    const low = score(0.0005), high = score(0.995), inside = p => p > 0.0005 && p < 0.995;
    const across = v => { const one = model.sliders.get(path); return BOX.l + (BOX.r - BOX.l) * Math.log(v / one.low) / Math.log(one.high / one.low); };
    const up = p => BOX.b - (BOX.b - BOX.t) * (score(clip(p, 1e-9, 1 - 1e-9)) - low) / (high - low);
    const line = (kind, x1, y1, x2, y2) => `<line class="${kind}" x1="${x1}" y1="${y1}" x2="${x2}" y2="${y2}"/>`;
    const text = (kind, x, y, at, words) => `<text class="${kind}" x="${x}" y="${y}" text-anchor="${at}" paint-order="stroke">${safe(words)}</text>`;
    const level = of => limit.aim === "survive" ? of : 1 - of;

    function frame() { // what no setting moves: scales, and the study's own curve
      path = !data.surfaces[limit.quantity] ? "" : model.sliders.has(limit.solve) ? limit.solve : data.sliders.length ? data.sliders[0].path : "";
      drawing.style.display = path ? "" : "none";
      if (!path) return;
      const one = model.sliders.get(path), words = one.label.toLowerCase(), decade = 10 ** Math.floor(Math.log10(one.low * one.factor));
      const marks = STEPS.map(k => k * decade).filter(v => v >= one.low * one.factor * 0.999 && v <= one.high * one.factor * 1.001);
      const own = model.curve(limit, study, path, 17), { target } = study.limits[limit.name], start = target ? model.crossing(own, level(target)) : null;
      // the run knows its own answer better
      trusted = limit.solve === path && limit.solved && start ? limit.solved / start : 1;
      drawing.innerHTML = `<title id="${id("title")}">Share broken over ${safe(words)}</title>` +
        TICKS.map(p => line("grid", BOX.l, up(p), BOX.r, up(p)) + text("soft", BOX.l - 5, up(p) + 4, "end", plain(100 * p))).join("") +
        line("axis", BOX.l, BOX.b, BOX.r, BOX.b) + marks.map(m => [m, across(m / one.factor)]).map(([m, x]) =>
          line("axis", x, BOX.b, x, BOX.b + 4) + text("soft", x, BOX.b + 18, "middle", plain(m))).join("") +
        text("", BOX.r, BOX.b + 35, "end", `${words}, ${one.unit}; share broken, %`) + `<path class="curve study" d="${drawn(own.x, own.own)}"/><g></g>`;
    }

    function drawn(x, values) {
      const every = values.length === x.length ? 1 : 2, kept = values.map((p, k) => [p, x[every * k]]).filter(([p]) => inside(p));
      return kept.length ? "M" + kept.map(([p, v]) => across(v).toFixed(1) + " " + up(p).toFixed(1)).join("L") : "";
    }

    function named(kind, words, d, width, part, dash = "none") { // a curve, and its name beside a part of its way
      const points = d.slice(1).split("L"), [x, y] = (points[Math.floor(points.length * part)] || "").split(" ").map(Number), right = x < 400;
      return d && `<path class="curve ${kind}" stroke-width="${width}" stroke-dasharray="${dash}" d="${d}"/>` +
        text(`halo ${kind}`, x + (right ? 7 : -7), y + 14, right ? "start" : "end", words);
    }

    function draw(found) { // what a setting moves: its curves, its place and its interval, the target
      const one = model.sliders.get(path), { target } = setting.limits[limit.name], parts = [];
      const shown = found && model.curve(limit, setting, path, 17), x = across(clip(setting.at[path], one.low, one.high));
      solved = shown && target ? model.crossing(shown, level(target)) : null;
      if (found && found.kind === "estimate") parts.push(`<path class="band" d="M${x - 4} ${up(level(found.low))}h8V${up(level(found.high))}h-8Z"/>`);
      if (target && inside(level(target))) parts.push(line("target", BOX.l, up(level(target)), BOX.r, up(level(target))));
      parts.push(line("plan", x, BOX.t, x, BOX.b));
      limit.ways.forEach((way, k) => {
        const kind = ["core", "energy"].find(word => way.name.includes(word)) || "other";
        if (shown && !setting.ways.has(way.name)) parts.push(named(kind + " soft", way.name, drawn(shown.x, shown.ways[k]), 1.8, [0.3, 0.8, 0.6, 0.45][k % 4], DASHES[kind]));
      });
      if (shown) parts.push(named("contact strong", limit.label.toLowerCase(), drawn(shown.x, shown.own), 2.4, 0.66));
      drawing.lastChild.innerHTML = parts.join("");
      if (shown && target) second.textContent = `${one.label} at the target: ` +
        (solved ? two(solved * trusted * one.factor) + GAP + one.unit : "beyond the stored runs");
    }

    // --- one move

    function commands() { // what would be run for this setting
      const own = setting.limits[limit.name], before = study.limits[limit.name], strength = `limits.${limit.name}.strength`, { law } = limit;
      const mean = `"${plain(own.mean * limit.factor)} ${limit.file_unit}"`, weibull = law.kind === "weibull", set = [];
      for (const one of data.sliders.filter(one => setting.at[one.path] !== study.at[one.path])) {
        const number = ratio => `"${plain(setting.at[one.path] * ratio * one.factor)} ${one.file_unit}"`;
        set.push(`${one.set}=${number(1)}`, ...Object.entries(one.cut).map(([key, ratio]) => `${one.key}.${key}=${number(ratio)}`));
      }
      if (own.mean !== before.mean || own.scatter) {
        const scatter = `${weibull ? "modulus" : "cov"} = ${plain(own.scatter || (weibull ? law.m : Math.sqrt(Math.expm1(law.sd ** 2))))}`;
        set.push(law.kind === "fixed" ? `${strength}=${mean}` : law.kind === "table" ? `${strength}.mean=${mean}` :
          `${strength}={ dist = "${law.kind}", mean = ${mean}, ${scatter} }`);
      }
      if (own.spearman !== before.spearman) set.push(`dependence=[{ of = ["${limit.tie.with}", "${strength}"], spearman = ${plain(own.spearman)} }]`);
      if (own.target !== before.target) set.push(`limits.${limit.name}.target=${plain(own.target)}`);
      return "uqsphere run study.toml" + set.map(text => ` --set '${text}'`).join("");
    }

    function update() {
      due = false;
      controls.forEach(read => read());
      const found = model.answer(limit, setting), verdict = found && model.verdict(limit, setting, found), fine = p => p < 1e-6 ? "0" : two(100 * p, 3);
      const lit = verdict ? (verdict.word === "undecided" ? "not established" : verdict.word) : "";
      what.textContent = `Share ${limit.aim === "survive" ? "broken" : "left whole"}, ${limit.label.toLowerCase()}`;
      big.textContent = found ? percent(found.value, setting.limits[limit.name].target) : "no answer";
      interval.textContent = !found ? "No stored run covers this setting. Run it:" : (found.kind === "exact" ? "Exact from rows: " : "Estimate: ") +
        (found.high < 1e-6 ? "at most 0.0001" : `${fine(found.low)} to ${fine(found.high)}`) + GAP + "%";
      [...light.children].forEach((lamp, k) => lamp.classList.toggle("on", lamps[k][0] === lit));
      light.setAttribute("aria-label", verdict ? "Verdict: " + verdict.word : "No verdict");
      light.style.display = limit.target ? "" : "none";
      reason.textContent = verdict ? verdict.reasons.map(text => text[0].toUpperCase() + text.slice(1) + ".").join(" ") : "";
      section.classList.toggle("grey", !found);
      command.hidden = !!found;
      command.firstChild.textContent = found ? "" : commands();
      second.textContent = "";
      if (path) draw(found);
      clearTimeout(spoken);
      spoken = setTimeout(() => { live.textContent = `${what.textContent}: ${big.textContent}. ${verdict ? "Verdict: " + verdict.word : ""}`; }, 500);
    }

    const change = () => { if (!due) requestAnimationFrame(update); due = true; };
    section.setAttribute("aria-labelledby", id("head"));
    section.setAttribute("role", "region");
    section.hidden = false;
    fill();
    update();
    return { update };
  }

  root.uqsphereWhatIf = { makeModel, panels: [...document.querySelectorAll(".whatif")].map(build) };
})(typeof globalThis === "undefined" ? this : globalThis);
