(() => {
  "use strict";
  const root = document.documentElement;
  const data = JSON.parse(document.getElementById("imucal-data").textContent);
  const plots = [...document.querySelectorAll(".plot")];
  const darkness = matchMedia("(prefers-color-scheme: dark)");

  const isDark = () => (root.dataset.theme === "auto" ? darkness.matches : root.dataset.theme === "dark");
  const colour = (name) => data.colours[name][isDark() ? 1 : 0];
  const css = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const dashes = { Q: "2px,4px", N: "9px,3px", B: "9px,3px,2px,3px", GM: "5px,3px", K: "14px,5px", R: "11px,3px,2px,3px,2px,3px" };
  const times = (values, factor) => values.map((v) => (v === null ? null : v * factor));
  const number = (v) => (v === null || v === undefined ? "?" : Number(v).toPrecision(4).replace(/e([+-]\d+)/, " × 10^$1").replace("^+", "^"));

  const scale = (title, extra) => ({
    title: { text: title, standoff: 6 }, gridcolor: css("--grid"), linecolor: css("--rule"), zeroline: false,
    showline: true, ticks: "outside", tickcolor: css("--rule"), automargin: true, ...extra,
  });
  const log = (title, range) => scale(title, { type: "log", exponentformat: "power", dtick: range[1] - range[0] < 1.6 ? "D2" : 1, range });
  const layout = (x, y, extra) => ({
    xaxis: x, yaxis: y, margin: { l: 64, r: 12, t: 30, b: 44 }, hovermode: "closest",
    modebar: { bgcolor: "rgba(0,0,0,0)", color: css("--second"), activecolor: css("--accent") },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: css("--ink"), size: 13, family: getComputedStyle(document.body).fontFamily },
    legend: { orientation: "h", yref: "container", y: 0, yanchor: "bottom", x: 0, font: { size: 12 } },
    hoverlabel: { align: "left", bgcolor: css("--paper"), bordercolor: css("--rule"), font: { color: css("--ink") } },
    ...extra,
  });
  const span = (values) => {
    const known = values.filter((v) => v > 0);
    return [Math.log10(Math.min(...known)) - 0.3, Math.log10(Math.max(...known)) + 0.3];
  };
  // The axis reaches below the curve to show a read-off, but not by more than a factor of 40.
  const deep = (adev, labels) => {
    const [bottom, top] = span(adev);
    const heights = labels.map((l) => Math.log10(l.y) - 0.2).filter((h) => h > bottom - 1.6);
    return [Math.min(bottom, ...heights), top];
  };
  const line = (name, width, dash) => ({ mode: "lines", hoverinfo: "skip", line: { color: colour(name), width, dash } });

  function allan(axis) {
    const [unit, factor] = axis.units[root.dataset.units];
    const curve = axis.curve, fine = axis.fine;
    const adev = times(curve.adev, factor), low = times(curve.low, factor), high = times(curve.high, factor);
    const model = times(curve.model, factor);
    const traces = [
      { x: curve.tau, y: low, mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false },
      { x: curve.tau, y: high, mode: "lines", line: { width: 0 }, fill: "tonexty", hoverinfo: "skip",
        fillcolor: isDark() ? "rgba(120,160,200,.25)" : "rgba(120,160,200,.35)", name: `${axis.level} % interval` },
    ];
    for (const term of fine.terms) {
      traces.push({ x: fine.tau, y: times(term.adev, factor), ...line(term.symbol, 1.6, dashes[term.symbol]),
        opacity: term.bounded ? 0.6 : 1, name: `${term.key}${term.bounded ? " (bound)" : ""}`, legendgroup: term.key });
    }
    traces.push({ x: fine.tau, y: times(fine.adev, factor), ...line("model", 2.4), name: `model ${axis.model}` });
    for (const used of [1, 0]) {
      const index = curve.used.flatMap((u, i) => (u === used ? [i] : []));
      if (!index.length) continue;
      const pick = (values) => index.map((i) => values[i]);
      traces.push({
        x: pick(curve.tau), y: pick(adev), mode: "markers", name: used ? "Allan deviation" : "not used by the fit",
        meta: "points",
        marker: { color: colour(used ? "data" : "unused"), size: 7 },
        customdata: index.map((i) => [number(low[i]), number(high[i]), number(model[i]), number(adev[i]), number(curve.tau[i]), number(curve.edf[i])]),
        hovertemplate: `τ = %{customdata[4]} s<br><b>%{customdata[3]} ${unit}</b><br>${axis.level} %: %{customdata[0]} to %{customdata[1]}` +
          "<br>model: %{customdata[2]}<br>degrees of freedom: %{customdata[5]}<extra></extra>",
      });
    }
    for (const term of fine.terms) {
      traces.push({
        x: [term.at[0]], y: [term.at[1] * factor], mode: "markers", showlegend: false, legendgroup: term.key,
        marker: { symbol: term.bounded ? "triangle-down-open" : "diamond", size: 10, color: colour(term.symbol), line: { color: css("--paper"), width: 1 } },
        hovertemplate: `<b>${term.key}</b> ${term.name}<br>${term[root.dataset.units]}<extra></extra>`,
      });
    }
    const floor = axis.minimum;
    traces.push({
      x: [floor.at[0]], y: [floor.at[1] * factor], mode: "markers", showlegend: false,
      marker: { symbol: "circle-open", size: 14, color: css("--ink"), line: { width: 1.5 } },
      hovertemplate: `${floor[root.dataset.units]}<extra></extra>`,
    });
    const labels = fine.terms.map((term) => ({
      text: term.label[root.dataset.units], colour: colour(term.symbol), x: term.at[0], y: term.at[1] * factor,
      line: { x: fine.tau, y: times(term.adev, factor) },
    }));
    labels.push({ text: floor[root.dataset.units], colour: css("--ink"), x: floor.at[0], y: floor.at[1] * factor });
    const covered = [{ x: curve.tau, y: adev }, { x: fine.tau, y: times(fine.adev, factor) }];
    return [traces, layout(log("averaging time τ (s)", span(curve.tau)), log(`Allan deviation (${unit})`, deep(adev, labels))), { labels, covered }];
  }

  function psd(axis) {
    const [, , unit, factor] = axis.units[root.dataset.units];
    const fine = axis.fine, s = axis.psd;
    const y = times(s.root, factor), model = times(s.model, factor);
    const low = times(s.low, factor), high = times(s.high, factor);
    const traces = [
      { x: s.f, y: low, mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false },
      { x: s.f, y: high, mode: "lines", line: { width: 0 }, fill: "tonexty", hoverinfo: "skip", showlegend: false,
        fillcolor: isDark() ? "rgba(120,160,200,.25)" : "rgba(120,160,200,.35)" },
    ];
    traces.push({
      x: s.f, y, mode: "lines", meta: "points", line: { color: colour("data"), width: 1.2 }, name: "√PSD",
      customdata: s.f.map((f, i) => [number(f), number(y[i]), number(model[i]), number(low[i]), number(high[i])]),
      hovertemplate: `%{customdata[0]} Hz<br><b>%{customdata[1]} ${unit}</b><br>${axis.level} %: %{customdata[3]} to %{customdata[4]}` +
        "<br>model: %{customdata[2]}<extra></extra>",
    });
    for (const term of fine.terms.filter((t) => !t.bounded && t.root.some((v) => v > 0))) {
      traces.push({ x: fine.f, y: times(term.root, factor), ...line(term.symbol, 1.4, dashes[term.symbol]), showlegend: false });
    }
    traces.push({ x: fine.f, y: times(fine.root, factor), ...line("model", 2.4), name: "model" });
    if (s.lines.length) {
      const near = (f) => s.f.reduce((best, v, i) => (Math.abs(v - f) < Math.abs(s.f[best] - f) ? i : best), 0);
      traces.push({
        x: s.lines.map((l) => l[0]), y: s.lines.map((l) => y[near(l[0])] * 1.12), mode: "markers", name: "line left out",
        marker: { symbol: "triangle-down", size: 11, color: colour("line") },
        customdata: s.lines.map((l) => [number(l[0])]),
        hovertemplate: "line at %{customdata[0]} Hz<br>left out of the fit<extra></extra>",
      });
    }
    const range = s.f.length ? [Math.log10(s.f[0]) - 0.1, Math.log10(s.f[s.f.length - 1]) + 0.1] : [0, 1];
    const grey = { type: "rect", xref: "x", yref: "paper", y0: 0, y1: 1, line: { width: 0 }, layer: "below", fillcolor: colour("unused"), opacity: 0.3 };
    const shapes = [];
    if (s.band && s.f.length) {
      if (s.f[0] < s.band[0]) shapes.push({ ...grey, x0: 10 ** range[0], x1: s.band[0] });
      if (s.f[s.f.length - 1] > s.band[1] * 1.01) shapes.push({ ...grey, x0: s.band[1], x1: 10 ** range[1] });
    }
    const annotations = [];
    if (s.filter) {
      shapes.push({ type: "line", xref: "x", yref: "paper", x0: s.filter, x1: s.filter, y0: 0, y1: 1, line: { color: css("--ink"), width: 1, dash: "dot" } });
      annotations.push({ x: Math.log10(s.filter), y: 0.02, yref: "paper", xanchor: "right", yanchor: "bottom", showarrow: false, align: "right",
        text: `output filter<br>-3 dB at ${number(s.filter)} Hz`, font: { size: 11 } });
    }
    return [traces, layout(log("frequency (Hz)", range), log(`√PSD, two-sided (${unit})`, y.length ? span(y) : [0, 1]), { shapes, annotations })];
  }

  function raw(axis) {
    const [unit, factor] = axis.units[root.dataset.units];
    const last = axis.raw.t[axis.raw.t.length - 1] || 0;
    const [clock, seconds] = last > 7200 ? ["h", 3600] : last > 600 ? ["min", 60] : ["s", 1];
    const r = { t: times(axis.raw.t, 1 / seconds), gaps: axis.raw.gaps.map((g) => times(g, 1 / seconds)), out: times(axis.raw.out, 1 / seconds), low: axis.raw.low, high: axis.raw.high };
    const low = times(r.low, factor), high = times(r.high, factor);
    const fill = isDark() ? "rgba(93,182,242,.45)" : "rgba(0,99,163,.4)";
    // One outline for each unbroken run, all in one trace: there and back, then a null.
    const x = [], y = [], known = [];
    for (let start = 0, i = 0; i <= r.t.length; i++) {
      if (i < r.t.length && low[i] !== null) { known.push(i); continue; }
      const run = known.slice(start);
      start = known.length;
      if (!run.length) continue;
      const back = [...run].reverse();
      x.push(...[...run, ...back, run[0]].map((k) => r.t[k]), null);
      y.push(...run.map((k) => high[k]), ...back.map((k) => low[k]), high[run[0]], null);
    }
    const traces = [
      { x, y, mode: "lines", fill: "toself", fillcolor: fill, line: { color: colour("model"), width: 0.8 }, hoverinfo: "skip", showlegend: false },
      { x: known.map((k) => r.t[k]), y: known.map((k) => (low[k] + high[k]) / 2), mode: "markers", meta: "points",
        marker: { opacity: 0, color: colour("model") }, showlegend: false,
        customdata: known.map((k) => [number(low[k]), number(high[k]), number(r.t[k])]),
        hovertemplate: `%{customdata[2]} ${clock}<br>%{customdata[0]} to %{customdata[1]} ${unit}<extra></extra>` },
    ];
    const shapes = r.gaps.map(([from, to]) => ({
      type: "rect", xref: "x", yref: "paper", x0: from, x1: to, y0: 0, y1: 1, layer: "below",
      fillcolor: colour("line"), opacity: 0.22, line: { color: colour("line"), width: 1 },
    }));
    if (r.gaps.length) traces.push({ x: [null], y: [null], mode: "markers", name: "gap", marker: { symbol: "square", size: 11, color: colour("line"), opacity: 0.4 } });
    if (r.out.length) {
      const top = Math.max(...high.filter((v) => v !== null));
      traces.push({
        x: r.out, y: r.out.map(() => top), mode: "markers", name: "stands out: spike or touch",
        marker: { symbol: "triangle-down", size: 9, color: colour("N") },
        hovertemplate: `%{x:.4g} ${clock}: samples far from their neighbours<extra></extra>`,
      });
    }
    return [traces, layout(scale(`time (${clock})`, { range: [0, last / seconds || 1] }), scale(unit, { exponentformat: "power", nticks: 5 }), {
      shapes, legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", yref: "paper" }, margin: { l: 64, r: 12, t: 30, b: 40 },
      showlegend: r.gaps.length + r.out.length > 0, hovermode: "x",
    })];
  }

  // Labels find a free place beside their point, as in the pictures: on growing circles about it the
  // place that leaves the frame, covers others or the curve the least.
  const pencil = document.createElement("canvas").getContext("2d");
  const ANGLES = [45, 315, 135, 225, 90, 270, 0, 180, 22, 338, 158, 202, 67, 293, 113, 247].map((d) => (d * Math.PI) / 180);
  const DISTANCES = [10, 18, 30, 45, 65, 90, 120, 160, 200];

  function dense(points) {
    const found = [];
    points.forEach(([x, y], i) => {
      const [u, v] = points[i + 1] || [x, y];
      const steps = Math.max(1, Math.ceil(Math.hypot(u - x, v - y) / 4));
      for (let k = 0; k < steps; k++) found.push([x + ((u - x) * k) / steps, y + ((v - y) * k) / steps]);
    });
    return found;
  }

  function place(plot, { labels, covered }) {
    const { xaxis, yaxis } = plot._fullLayout;
    const width = xaxis._length, height = yaxis._length, size = width < 420 ? 11 : 12;
    const pixel = (x, y) => [xaxis.l2p(Math.log10(x)), yaxis.l2p(Math.log10(y))];
    const track = (line) => line.x.map((x, i) => [x, line.y[i]]).filter(([, y]) => y > 0).map(([x, y]) => pixel(x, y));
    const curve = covered.flatMap((line) => dense(track(line)));
    const inside = ([x, y]) => x >= 0 && x <= width && y >= 0 && y <= height;
    pencil.font = `${size}px ${plot._fullLayout.font.family}`;
    const taken = [];
    const overlap = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
    const annotations = [];
    const known = labels.map((label) => {
      const own = pixel(label.x, label.y);
      const along = label.line ? track(label.line).filter(inside) : [];
      const anchors = inside(own) ? [own] : along.filter((_, i) => i % Math.max(1, Math.floor(along.length / 10)) === 0);
      const rows = label.text.split("<br>");
      return { label, anchors, w: Math.max(...rows.map((r) => pencil.measureText(r).width)) + 6, h: rows.length * size * 1.3 + 4 };
    });
    known.filter((k) => k.anchors.length === 1).forEach(({ anchors: [[x, y]] }) => taken.push([x - 7, y - 7, x + 7, y + 7]));
    known.sort((a, b) => (a.anchors.length > 1) - (b.anchors.length > 1));
    for (const { label, anchors, w, h } of known) {
      let best = null;
      for (const [x, y] of anchors) for (const distance of DISTANCES) for (const angle of ANGLES) {
        const cx = x + Math.cos(angle) * (distance + w / 2), cy = y - Math.sin(angle) * (distance + h / 2);
        const box = [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2];
        let cost = distance / 25;
        if (box[0] < 2 || box[1] < 2 || box[2] > width - 2 || box[3] > height - 2) cost += 1e4;
        cost += 1e3 * taken.filter((other) => overlap(box, other)).length;
        if (best && cost >= best.cost) continue;
        cost += 2 * curve.filter(([u, v]) => u > box[0] && u < box[2] && v > box[1] && v < box[3]).length;
        if (!best || cost < best.cost) best = { cost, x, y, cx, cy, box };
      }
      if (!best || best.cost >= 1e4) continue;
      taken.push(best.box);
      annotations.push({
        x: xaxis.p2l(best.x), y: yaxis.p2l(best.y), ax: best.cx - best.x, ay: best.cy - best.y, text: label.text, showarrow: true,
        arrowhead: 0, arrowwidth: 0.8, arrowcolor: label.colour, standoff: 4, borderpad: 1, bgcolor: css("--paper"), opacity: 0.95,
        font: { size, color: label.colour },
      });
    }
    return annotations;
  }

  const makers = { allan, psd, raw };
  const drawn = new Set();
  let ready = false;
  let watcher;

  // Two stops for the Tab key: the plot, and its buttons, among which the arrow keys move.
  function tame(plot) {
    const buttons = [...plot.querySelectorAll(".modebar-btn")];
    buttons.forEach((button, i) => {
      button.tabIndex = i ? -1 : 0;
      button.onkeydown = (event) => {
        const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
        const next = buttons[i + step];
        if (!next) return;
        button.tabIndex = -1;
        next.tabIndex = 0;
        next.focus();
        event.preventDefault();
      };
    });
  }

  function draw(plot) {
    if (!ready) return;
    const [traces, shape, marks] = makers[plot.dataset.plot](data.axes[plot.dataset.axis]);
    const config = { responsive: true, displaylogo: false, modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]], toImageButtonOptions: { filename: plot.id } };
    shape.autosize = true;
    window.Plotly.react(plot, traces, shape, config).then(() => {
      if (marks) window.Plotly.relayout(plot, { annotations: place(plot, marks) });
      tame(plot);
    });
    drawn.add(plot);
  }
  // What lies in a section that was folded again has no size; it is drawn when it is seen.
  const redraw = () => drawn.forEach((plot) => { if (plot.clientWidth) draw(plot); else { drawn.delete(plot); watcher.observe(plot); } });

  for (const input of document.querySelectorAll(".controls input")) {
    input.addEventListener("change", redraw);
  }
  darkness.addEventListener("change", redraw);
  // The labels' places depend on the size.
  let resized = 0;
  addEventListener("resize", () => {
    clearTimeout(resized);
    resized = setTimeout(redraw, 200);
  });

  for (const plot of plots) {
    let at = -1;
    plot.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!step || event.target !== plot || !drawn.has(plot)) return;
      const points = plot.data.flatMap((trace, curveNumber) =>
        trace.meta === "points" ? trace.x.map((x, pointNumber) => ({ x, curveNumber, pointNumber })) : []);
      points.sort((a, b) => a.x - b.x);
      if (!points.length) return;
      at = Math.min(Math.max(at + step, 0), points.length - 1);
      const { curveNumber, pointNumber } = points[at];
      window.Plotly.Fx.hover(plot, [{ curveNumber, pointNumber }]);
      const { customdata, hovertemplate } = plot.data[curveNumber];
      document.getElementById("announcement").textContent = hovertemplate
        .replace(/%\{customdata\[(\d)\]\}/g, (_, k) => customdata[pointNumber][k])
        .replace(/<br>/g, ", ").replace(/<extra>.*|<[^>]*>/g, "");
      event.preventDefault();
    });
    plot.addEventListener("blur", () => { if (drawn.has(plot)) window.Plotly.Fx.unhover(plot); at = -1; });
  }

  async function unpack() {
    const packed = Uint8Array.from(atob(document.getElementById("imucal-plotly").textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
    ready = true;
    root.dataset.ready = "yes";
    watcher = new IntersectionObserver((entries) => {
      for (const { isIntersecting, target } of entries) {
        if (!isIntersecting) continue;
        watcher.unobserve(target);
        draw(target);
      }
    }, { rootMargin: "600px" });
    plots.forEach((plot) => watcher.observe(plot));
  }
  unpack().catch((error) => {
    document.getElementById("no-plots").hidden = false;
    console.error(error);
  });
})();
