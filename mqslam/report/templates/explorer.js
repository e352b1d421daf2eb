// The interactive part of a report: a map that pans and zooms, curves over time, and the place that was clicked.
// What it shows stands as JSON in #scene, see explorer.py; without WebGL or in print the pictures of the page remain.
"use strict";
(() => {
  if (!document.createElement("canvas").getContext("webgl")) return;
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const ink = getComputedStyle(document.body).getPropertyValue("--ink").trim();
  const line = getComputedStyle(document.body).getPropertyValue("--line").trim();
  const soft = getComputedStyle(document.body).getPropertyValue("--soft").trim();
  const kinds = { u1: Uint8Array, u2: Uint16Array, i2: Int16Array, f4: Float32Array };
  const decoded = ({ dtype, data, low, step }) => {
    const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
    const codes = new kinds[dtype](bytes.buffer);
    return step === 1 && low === 0 ? codes : Float32Array.from(codes, (code) => low + step * code);
  };
  const plain = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
  const byId = (id) => document.getElementById(id);
  const narrow = () => window.innerWidth < 760;
  const settings = { responsive: true, displaylogo: false, scrollZoom: true, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
  const bare = { ...settings, displayModeBar: false };
  const base = {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, size: 12 }, hovermode: "closest",
    legend: { orientation: "h", x: 0, y: 1.01, xanchor: "left", yanchor: "bottom" },
    modebar: { orientation: "v", bgcolor: "rgba(0,0,0,0)", color: soft, activecolor: ink },
  };
  const axis = (more) => ({ gridcolor: line, zerolinecolor: line, linecolor: line, ...more });

  // the map
  const layers = scene.layers.map((layer) => ({
    ...layer, x: decoded(layer.x), y: decoded(layer.y), pathTimes: decoded(layer.path_times),
    pathX: decoded(layer.path_x), pathY: decoded(layer.path_y),
    values: Object.fromEntries(Object.entries(layer.values).map(([name, array]) => [name, decoded(array)])),
  }));
  const nearest = (sorted, value) => {
    let low = 0, high = sorted.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (sorted[middle] < value) low = middle + 1; else high = middle;
    }
    return low > 0 && value - sorted[low - 1] < sorted[low] - value ? low - 1 : low;
  };
  const whereAt = (layer, time) => {
    const k = nearest(layer.pathTimes, time);
    return [layer.pathX[k], layer.pathY[k]];
  };
  // every trace has an entry in the legend, which is made of buttons, so that the keyboard reaches them
  const traces = [], entries = [];
  const add = (trace, shape, name, shown = true) => {
    const k = traces.push({ ...trace, name: plain(name), visible: shown, showlegend: false }) - 1;
    entries.push({ k, name, shown, shape, colour: (trace.line || {}).color || trace.marker.color });
    return k;
  };
  const pointTraces = layers.map((layer) => add({
    type: "scattergl", mode: "markers", x: layer.x, y: layer.y, hoverinfo: "skip",
    marker: { size: 2, color: layer.ink || ink, opacity: 0.5 },
  }, "circle", `${layer.name}: map`, layer.shown));
  for (const layer of layers) add({
    type: "scattergl", mode: "lines", x: layer.pathX, y: layer.pathY, customdata: layer.pathTimes,
    line: { color: layer.colour, width: 2 }, hovertemplate: `%{customdata:.1f} s<extra>${plain(layer.name)}</extra>`,
  }, "line", layer.name);
  for (const extra of scene.lines) add({
    type: "scattergl", mode: "lines", x: decoded(extra.x), y: decoded(extra.y), hoverinfo: "skip",
    line: { color: extra.colour, width: extra.width },
  }, "line", extra.name, extra.shown);
  const main = layers.find((layer) => layer.shown) || layers[0];
  const middle = (place) => 0.5 * (place.t0 + place.t1);
  const dots = [["fine", "place to click", 8], ["unknown", "undecided place", 9], ["torn", "torn place", 12]];
  for (const [kind, name, size] of dots) {
    const places = scene.places.filter((place) => place.kind === kind);
    const spots = places.map((place) => whereAt(main, middle(place)));
    if (spots.length) add({
      type: "scatter", mode: "markers", x: spots.map((p) => p[0]), y: spots.map((p) => p[1]), customdata: places.map(middle),
      text: places.map((place) => plain(place.title)), hovertemplate: "%{text}<extra></extra>",
      marker: { size, symbol: scene.marks[kind], color: scene.colours[kind], line: { width: 1, color: "white" } },
    }, scene.marks[kind], name);
  }
  const accent = (torn) => (torn && !scene.calm ? scene.colours.torn : soft);
  const firstTorn = scene.places.length > 0 && scene.places[scene.first].torn;
  const chosenTrace = add({
    type: "scatter", mode: "markers", x: [], y: [], hoverinfo: "skip",
    marker: { size: 20, symbol: "circle-open", color: accent(firstTorn), line: { width: 3 } },
  }, "ring", "selected place");
  const [x0, x1, y0, y1] = scene.view;
  const box = { ...base, margin: { l: 56, r: 10, t: 10, b: 40 }, dragmode: "pan",
    xaxis: axis({ title: { text: "x [m]" }, range: [x0, x1] }),
    yaxis: axis({ title: { text: "y [m]" }, range: [y0, y1], scaleanchor: "x", scaleratio: 1 }) };

  // curves over time, one below the other
  const curves = [];
  const charts = { ...base, margin: { l: 64, r: 10, t: 30, b: 40 }, dragmode: "zoom",
    xaxis: axis({ title: { text: "time [s]" }, anchor: `y${scene.charts.length > 1 ? scene.charts.length : ""}` }), shapes: [] };
  scene.charts.forEach((chart, k) => {
    const id = k ? `${k + 1}` : "", height = 1 / scene.charts.length;
    charts[`yaxis${id}`] = axis({ title: { text: chart.title }, type: chart.log ? "log" : "linear", ...(chart.log ? { dtick: 1 } : {}),
      domain: [1 - (k + 1) * height + 0.06, 1 - k * height], rangemode: "tozero", exponentformat: "none" });
    for (const curve of chart.curves) curves.push({
      type: curve.dots ? "scatter" : "scattergl", mode: curve.dots ? "markers" : "lines", name: plain(curve.name), x: decoded(curve.times),
      y: decoded(curve.values), yaxis: `y${id}`, line: { color: curve.colour, width: 1.4 },
      marker: { color: curve.colour, size: curve.mark === scene.marks.torn ? 9 : 6, symbol: curve.mark },
      hovertemplate: `%{x:.1f} s: %{y:.3g}<extra>${plain(curve.name)}</extra>`,
    });
    for (const level of chart.levels) {
      charts.shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, yref: `y${id}`, y0: level.value, y1: level.value,
        line: { color: level.colour, width: 1, dash: "dash" } });
      (charts.annotations ||= []).push({ xref: "paper", x: 1, xanchor: "right", yref: `y${id}`, yanchor: "bottom",
        y: chart.log ? Math.log10(level.value) : level.value, text: plain(level.name), showarrow: false, font: { size: 11 } });
    }
  });

  // the place chosen
  const crops = decoded(scene.crops);
  let chosen = -1;
  const show = (k) => {
    if (!scene.places.length) return;
    chosen = (k + scene.places.length) % scene.places.length;
    const place = scene.places[chosen], time = middle(place);
    const at = layers.map((layer) => whereAt(layer, time));
    const colour = accent(place.torn);
    Plotly.restyle("map", { x: [at.map((p) => p[0])], y: [at.map((p) => p[1])], "marker.color": colour }, [chosenTrace]);
    const mark = { type: "rect", xref: "x", yref: "paper", x0: place.t0, x1: place.t1, y0: 0, y1: 1, layer: "below",
      line: { width: 1, color: colour }, fillcolor: colour, opacity: 0.25 };
    if (byId("charts")) Plotly.relayout("charts", { shapes: [...charts.shapes, mark] });
    const first = chosen === scene.first && scene.first_is ? `${scene.first_is}: ` : "";
    byId("place").textContent = first + place.title;
    byId("about").textContent = place.text;
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    for (const view of place.views) for (const [begin, end] of view.groups) for (let i = 2 * begin; i < 2 * end; i += 1) {
      low[i % 2] = Math.min(low[i % 2], crops[i]);
      high[i % 2] = Math.max(high[i % 2], crops[i]);
    }
    const half = 0.52 * Math.max(1, high[0] - low[0], high[1] - low[1]);
    const extent = (k) => [(low[k] + high[k]) / 2 - half, (low[k] + high[k]) / 2 + half];
    const columns = Math.min(place.views.length, narrow() ? 1 : Math.max(2, Math.ceil(place.views.length / 2)));
    const rows = Math.ceil(place.views.length / columns), wide = 1 / columns, tall = 1 / rows, views = [];
    const height = rows * (byId("crop").clientWidth / columns) + 60;
    byId("crop").style.height = `${height}px`;
    const layout = { ...base, height, margin: { l: 30, r: 10, t: 24, b: 24 }, dragmode: "pan", annotations: [], showlegend: false };
    place.views.forEach((view, n) => {
      const id = n ? `${n + 1}` : "", column = n % columns, row = Math.floor(n / columns);
      const across = [column * wide + 0.02, (column + 1) * wide - 0.02];
      const up = [1 - (row + 1) * tall + 0.05, 1 - row * tall - 0.05];
      layout[`xaxis${id}`] = axis({ domain: across, anchor: `y${id}`, range: extent(0), ...(n ? { matches: "x" } : {}) });
      layout[`yaxis${id}`] = axis({ domain: up, anchor: `x${id}`, range: extent(1), scaleanchor: `x${id}`,
        constrain: "domain", ...(n ? { matches: "y" } : {}) });
      layout.annotations.push({ text: plain(view.name), xref: "paper", yref: "paper", x: across[0], y: up[1], xanchor: "left",
        yanchor: "bottom", showarrow: false });
      view.groups.forEach(([begin, end], g) => views.push({
        type: "scatter", mode: "markers", name: scene.groups[g] || "", xaxis: `x${id}`, yaxis: `y${id}`, hoverinfo: "skip",
        x: Array.from(crops.subarray(2 * begin, 2 * end).filter((_, i) => i % 2 === 0)),
        y: Array.from(crops.subarray(2 * begin, 2 * end).filter((_, i) => i % 2 === 1)),
        marker: { size: 3, opacity: 0.7, color: view.colours[g] },
      }));
    });
    Plotly.react("crop", views, layout, bare);
  };
  const choose = (event) => {
    const point = event.points.find((p) => p.customdata !== undefined || p.data.yaxis !== undefined) || event.points[0];
    const time = point.customdata !== undefined ? point.customdata : point.x;
    let best = 0;
    scene.places.forEach((place, k) => {
      if (Math.abs(middle(place) - time) < Math.abs(middle(scene.places[best]) - time)) best = k;
    });
    show(best);
  };

  document.body.classList.add("alive");
  const scales = { time: "Viridis", psi: "Inferno", intensity: "Cividis" };
  byId("colour").addEventListener("change", ({ target }) => {
    const name = target.value, scaled = name !== "";
    layers.forEach((layer, k) => Plotly.restyle("map", {
      "marker.color": [scaled ? layer.values[name] : layer.ink || ink], "marker.colorscale": scales[name] || "Viridis",
      "marker.cmin": scaled ? scene.spans[name][0] : null, "marker.cmax": scaled ? scene.spans[name][1] : null,
      "marker.opacity": scaled ? 0.9 : 0.5, "marker.showscale": scaled && k === layers.indexOf(main),
      "marker.colorbar": scaled ? { title: { text: scene.units[name], side: "right" }, thickness: 12, len: 0.6 } : {},
    }, [pointTraces[k]]));
  });
  const showWhole = () => Plotly.relayout("map", { "xaxis.range": [x0, x1], "yaxis.range": [y0, y1] });
  byId("previous").addEventListener("click", () => show(chosen - 1));
  byId("next").addEventListener("click", () => show(chosen + 1));
  byId("whole").addEventListener("click", showWhole);

  // the keyboard: a step is a tenth of what is seen
  const move = (across, up, zoom) => {
    const { xaxis, yaxis } = byId("map")._fullLayout;
    const moved = ({ range: [low, high] }, step) => {
      const half = 0.5 * (high - low) * zoom, centre = 0.5 * (low + high) + 0.1 * step * (high - low);
      return [centre - half, centre + half];
    };
    Plotly.relayout("map", { "xaxis.range": moved(xaxis, across), "yaxis.range": moved(yaxis, up) });
  };
  const keys = {
    ArrowLeft: () => move(-1, 0, 1), ArrowRight: () => move(1, 0, 1), ArrowUp: () => move(0, 1, 1), ArrowDown: () => move(0, -1, 1),
    "+": () => move(0, 0, 0.8), "-": () => move(0, 0, 1.25), 0: showWhole, n: () => show(chosen + 1), p: () => show(chosen - 1),
  };
  byId("map").addEventListener("keydown", (event) => {
    const act = keys[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  });

  // the legend of the map
  const swatches = {
    "square-open": '<rect x="6" y="2" width="6" height="6" fill="none" stroke-width="2"/>',
    line: '<path d="M0 5H18" fill="none" stroke-width="3"/>', circle: '<circle cx="9" cy="5" r="3"/>',
    "triangle-up": '<path d="M9 0L14 9H4Z"/>', ring: '<circle cx="9" cy="5" r="4" fill="none" stroke-width="2"/>',
  };
  for (const entry of entries) {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("aria-pressed", String(entry.shown));
    button.innerHTML = `<svg width="18" height="10" aria-hidden="true">${swatches[entry.shape]}</svg>`;
    button.firstChild.style.color = entry.colour;
    button.append(entry.name);
    button.addEventListener("click", () => {
      const shown = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(shown));
      Plotly.restyle("map", { visible: shown }, [entry.k]);
    });
    byId("legend").append(button);
  }

  scene.groups.forEach((name, g) => {
    const swatch = document.createElement("span");
    swatch.innerHTML = `<svg width="12" height="10" aria-hidden="true"><circle cx="5" cy="5" r="3"/></svg>`;
    swatch.firstChild.style.fill = scene.places.length ? scene.places[0].views[0].colours[g] : ink;
    swatch.append(name);
    byId("key").append(swatch);
  });

  const plots = [Plotly.newPlot("map", traces, { ...box, showlegend: false }, settings)];
  if (byId("charts")) plots.push(Plotly.newPlot("charts", curves, charts, bare));
  Promise.all(plots).then(() => {
    byId("map").on("plotly_click", choose);
    if (byId("charts")) byId("charts").on("plotly_click", choose);
    show(scene.first);
    document.body.classList.add("ready");
  });
})();
