"use strict";
// Draws the plots and the 3D view of a report from the numbers in the page. No network.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const HEIGHT = 230;
  const DASHES = { line: [], points: [], dashed: [7, 4], dotted: [2, 3] };
  const MARKS = { first: "circle", second: "square", third: "triangle" };
  const MOST_DECADES = 40; // of an axis that is labelled
  const SPREAD = 9; // pixels between error bars that share an x
  const colour = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const plots = [];

  // ---- plots ------------------------------------------------------------------------------

  // The columns of a plot in uPlot's order: x, then all columns of all traces.
  const aligned = (plot) => [plot.x, ...plot.traces.flatMap((trace) => trace.columns)];

  const seriesOf = (plot) => {
    const found = [{ label: plot.xLabel }];
    const bands = [];
    for (const trace of plot.traces) {
      const stroke = () => colour(trace.colour);
      const base = { stroke, width: 1.5, points: { show: false } };
      if (trace.style === "band") {
        bands.push({ series: [found.length + 1, found.length], fill: () => colour("faint") + "66" });
        for (const edge of ["from", "to"]) {
          found.push({ ...base, width: 0.5, label: `${trace.label}, ${edge}`, class: "edge" });
        }
      } else if (trace.style === "bars") {
        found.push({ ...base, label: trace.label, paths: () => null });
        for (const edge of ["−1 σ", "+1 σ"]) {
          found.push({ ...base, label: `${trace.label} ${edge}`, paths: () => null, class: "edge" });
        }
      } else {
        const points = { show: trace.style === "points", size: 6 };
        found.push({ ...base, label: trace.label, dash: DASHES[trace.style], points });
      }
    }
    return [found, bands];
  };

  const mark = (ctx, shape, x, y, size, isHollow) => {
    ctx.beginPath();
    if (shape === "circle") ctx.arc(x, y, size, 0, 2 * Math.PI);
    else if (shape === "square") ctx.rect(x - size, y - size, 2 * size, 2 * size);
    else {
      ctx.moveTo(x, y - 1.3 * size);
      ctx.lineTo(x + 1.2 * size, y + size);
      ctx.lineTo(x - 1.2 * size, y + size);
      ctx.closePath();
    }
    if (isHollow) ctx.stroke();
    else ctx.fill();
  };

  const drawBars = (u, plot) => {
    const { ctx } = u;
    const scale = devicePixelRatio;
    let column = 1;
    plot.traces.forEach((trace, place) => {
      if (trace.style !== "bars" || !u.series[column].show) {
        column += trace.columns.length;
        return;
      }
      const aside = (place - (plot.traces.length - 1) / 2) * SPREAD * scale;
      ctx.save();
      ctx.beginPath();
      ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      ctx.clip();
      ctx.strokeStyle = ctx.fillStyle = colour(trace.colour);
      ctx.lineWidth = 1.5 * scale;
      plot.x.forEach((at, row) => {
        const [value, low, high] = trace.columns.map((each) => each[row]);
        if (value === null) return;
        const x = u.valToPos(at, "x", true) + aside;
        const y = (v) => u.valToPos(v, "y", true);
        const [top, bottom] = [u.bbox.top, u.bbox.top + u.bbox.height];
        const isBeyond = y(value) < top || y(value) > bottom;
        ctx.beginPath();
        ctx.moveTo(x, y(low));
        ctx.lineTo(x, y(high));
        ctx.stroke();
        const size = 3.5 * scale;
        // Beyond the plot: a hollow mark at its edge.
        const held = Math.max(top + 1.5 * size, Math.min(bottom - 1.5 * size, y(value)));
        mark(ctx, MARKS[trace.colour], x, held, size, isBeyond);
      });
      ctx.restore();
      column += trace.columns.length;
    });
  };

  const drawBehind = (u, plot) => {
    const { ctx } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    ctx.clip();
    ctx.fillStyle = colour("shade");
    for (const [from, to] of plot.shaded) {
      const left = u.valToPos(from, "x", true);
      const width = Math.max(u.valToPos(to, "x", true) - left, devicePixelRatio);
      ctx.fillRect(left, u.bbox.top, width, u.bbox.height);
    }
    ctx.strokeStyle = ctx.fillStyle = colour("quiet");
    ctx.lineWidth = devicePixelRatio;
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    ctx.textAlign = "left";
    ctx.textBaseline = "alphabetic";
    for (const [name, value] of plot.levels) {
      const y = u.valToPos(value, "y", true);
      ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
      ctx.beginPath();
      ctx.moveTo(u.bbox.left, y);
      ctx.lineTo(u.bbox.left + u.bbox.width, y);
      ctx.stroke();
      if (name) ctx.fillText(name, u.bbox.left + 6 * devicePixelRatio, y - 4 * devicePixelRatio);
    }
    ctx.restore();
  };

  // Of values and of the lines drawn across: a range that holds both.
  const rangeOf = (plot) => (u, least, most) => {
    if (plot.yRange) return plot.yRange;
    const isLog = plot.log.includes("y");
    const values = plot.levels.map((each) => each[1]).filter((v) => !isLog || v > 0);
    const low = Math.min(least ?? (isLog ? 0.1 : 0), ...values);
    const high = Math.max(most ?? 1, ...values);
    return isLog ? uPlot.rangeLog(low, high, 10, true) : uPlot.rangeNum(low, high, 0.08, true);
  };

  // All plots that zoom together with one, itself included.
  const groupOf = (u) =>
    plots.map((each) => each.u).filter((other) => other === u || (u.group && other.group === u.group));

  const zoomTogether = (u, range) => groupOf(u).forEach((other) => other.setScale("x", range));

  const wholeRange = (u) => {
    const ends = groupOf(u).flatMap(({ data: [x] }) => [x[0], x[x.length - 1]]);
    const [least, most] = [Math.min(...ends), Math.max(...ends)];
    const margin = u.log ? 0 : 0.01 * (most - least || 1);
    return { min: u.log ? least / 1.2 : least - margin, max: u.log ? most * 1.2 : most + margin };
  };

  const format = (u, values) => values.map((v) => (v === null ? "" : String(+v.toPrecision(4))));

  // Of a logarithmic axis: powers of ten, and twos and fives where there is room for them.
  const roundSplits = (u, axis, least, most) => {
    const decades = Math.log10(most / least);
    const found = [];
    if (!(least > 0) || !(decades < MOST_DECADES)) return [least, most];
    for (let power = Math.floor(Math.log10(least)); power <= Math.log10(most); power++) {
      for (const digit of decades > 3 ? [1] : [1, 2, 5]) found.push(+`${digit}e${power}`);
    }
    return found.filter((v) => v >= least && v <= most);
  };

  const make = (place) => {
    const plot = data.plots[place.dataset.plot];
    const [series, bands] = seriesOf(plot);
    for (const each of series) {
      each.value = (u, v) => (v === null || v === undefined ? "–" : String(+v.toPrecision(5)));
    }
    const logX = plot.log.includes("x");
    const axis = (label, size, isLog, at) => ({
      ...(isLog ? { splits: roundSplits, filter: (u, splits) => splits } : {}),
      ...(at ? { splits: () => at, filter: (u, splits) => splits } : {}),
      label,
      size,
      labelSize: 22,
      stroke: () => colour("ink"),
      grid: { stroke: () => colour("line"), width: 1 },
      ticks: { stroke: () => colour("line"), width: 1 },
      values: format,
      font: "12px system-ui, sans-serif",
      labelFont: "12px system-ui, sans-serif",
    });
    const options = {
      title: plot.title,
      width: place.clientWidth,
      height: HEIGHT,
      series,
      bands,
      scales: {
        x: { time: false, distr: logX ? 3 : 1, range: (u, a, b) => (a === b ? [a - 1, b + 1] : [a, b]) },
        y: { distr: plot.log.includes("y") ? 3 : 1, range: rangeOf(plot) },
      },
      axes: [axis(plot.xLabel, 36, logX, plot.ticksAtX ? plot.x : null), axis(plot.yLabel, 62, plot.log.includes("y"))],
      cursor: {
        drag: { x: true, y: false, setScale: false },
        sync: plot.sharedX ? { key: plot.sharedX, setSeries: false } : undefined,
        bind: { dblclick: (u) => () => zoomTogether(u, wholeRange(u)) },
      },
      legend: {
        markers: {
          dash: (u, i) => (u.series[i].dash && u.series[i].dash.length ? "dashed" : "solid"),
        },
      },
      hooks: {
        drawAxes: [(u) => drawBehind(u, plot)],
        draw: [(u) => drawBars(u, plot)],
        setSelect: [
          (u) => {
            const { left, width } = u.select;
            if (width > 3 && u.cursor.event) {
              zoomTogether(u, { min: u.posToVal(left, "x"), max: u.posToVal(left + width, "x") });
            }
            u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
          },
        ],
      },
    };
    const u = new uPlot(options, aligned(plot), place);
    u.group = plot.sharedX;
    u.log = logX;
    plots.push({ u, place });
    place.addEventListener("keydown", (event) => {
      const { min, max } = u.scales.x;
      const [a, b] = logX ? [Math.log(min), Math.log(max)] : [min, max];
      const size = b - a;
      const moves = {
        "+": [0.25, -0.25], "=": [0.25, -0.25], "-": [-0.5, 0.5], ArrowLeft: [-0.2, -0.2], ArrowRight: [0.2, 0.2],
      };
      if (event.key === "0" || event.key === "Escape") zoomTogether(u, wholeRange(u));
      else if (moves[event.key]) {
        const [from, to] = [a + moves[event.key][0] * size, b + moves[event.key][1] * size];
        zoomTogether(u, logX ? { min: Math.exp(from), max: Math.exp(to) } : { min: from, max: to });
      } else return;
      event.preventDefault();
    });
  };

  const redraw = (width) => {
    for (const { u, place } of plots) {
      u.setSize({ width: width || place.clientWidth, height: HEIGHT });
      u.redraw();
    }
  };

  // ---- the mount in 3D --------------------------------------------------------------------

  const times = (R, v) => R.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  const plus = (a, b, k = 1) => a.map((value, i) => value + k * b[i]);
  const column = (R, i) => R.map((row) => row[i]);
  const length = (v) => Math.hypot(...v);

  // A square root L of a covariance, C = L L'; a direction that is known exactly gives zeros.
  const cholesky = (C) => {
    const L = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
    for (let i = 0; i < 3; i++) {
      for (let j = 0; j <= i; j++) {
        let sum = C[i][j];
        for (let k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
        L[i][j] = i === j ? Math.sqrt(Math.max(sum, 0)) : L[j][j] ? sum / L[j][j] : 0;
      }
    }
    return L;
  };

  const NAMES = ["x", "y", "z"];
  const AXES = ["second", "third", "first"];

  // Lines and labels of a scene: {from, to, colour, dashed} and {at, text}.
  const axesOf = (pose, size, dashed, name) => {
    const lines = [];
    const labels = [{ at: pose.t, text: name, place: name === "" ? "on" : pose === IDENTITY ? "left" : "right" }];
    for (let i = 0; i < 3; i++) {
      const tip = plus(pose.t, column(pose.R, i), size);
      lines.push({ points: [pose.t, tip], colour: AXES[i], dashed });
      // Those of the nominal pose would lie on those of the found one.
      if (!dashed) labels.push({ at: plus(pose.t, column(pose.R, i), 1.15 * size), text: NAMES[i], place: "on" });
    }
    return { lines, labels };
  };

  const joined = (...scenes) => ({
    lines: scenes.flatMap((each) => each.lines),
    labels: scenes.flatMap((each) => each.labels),
  });

  const IDENTITY = { R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], t: [0, 0, 0] };

  const overall = (mount) => {
    const far = Math.max(length(mount.t), mount.nominal ? length(mount.nominal.t) : 0, 0.02);
    const scenes = [
      axesOf(IDENTITY, 0.5 * far, false, mount.parent),
      axesOf(mount, 0.4 * far, false, mount.child),
      { lines: [{ points: [[0, 0, 0], mount.t], colour: "quiet", dotted: true }], labels: [] },
    ];
    if (mount.nominal) scenes.push(axesOf(mount.nominal, 0.4 * far, true, ""));
    return { ...joined(...scenes), centre: mount.t.map((v) => v / 2), radius: 1.05 * far };
  };

  const closeUp = (mount) => {
    if (!mount.covariance) return null;
    const L = cholesky(mount.covariance).map((row) => row.map((v) => 3 * v));
    const size = Math.max(...L.map(length));
    if (!size) return null;
    const onCircle = (u, v, angle) => u.map((a, i) => a * Math.cos(angle) + v[i] * Math.sin(angle));
    const ring = (u, v, colour) => ({
      points: Array.from({ length: 49 }, (_, k) => times(L, onCircle(u, v, (2 * Math.PI * k) / 48))),
      colour,
    });
    const [x, y, z] = IDENTITY.R;
    const lines = [ring(x, y, "first"), ring(y, z, "first"), ring(x, z, "first")];
    for (const turn of [0.35, 0.65]) lines.push(ring(onCircle(x, y, turn * Math.PI), z, "faint"));
    const { lines: axes, labels } = axesOf(IDENTITY, 1.25 * size, false, "");
    let radius = 1.6 * size;
    if (mount.nominal) {
      const away = plus(mount.nominal.t, mount.t, -1);
      const far = length(away);
      const inside = far < 4 * size;
      if (inside) radius = Math.max(radius, 1.3 * far);
      const tip = inside ? away : away.map((v) => (v / far) * 1.5 * size);
      lines.push({ points: [[0, 0, 0], tip], colour: "quiet", dashed: true });
      labels.push({ at: tip, text: inside ? "nominal" : `nominal, ${(far * 1e3).toPrecision(3)} mm away` });
    }
    return { lines: [...lines, ...axes], labels, centre: [0, 0, 0], radius };
  };

  const SVG = "http://www.w3.org/2000/svg";
  const VIEW = 300;

  const element = (name, attributes, text) => {
    const found = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
    if (text !== undefined) found.textContent = text;
    return found;
  };

  // 1, 2 or 5 of a power of ten, at most a length.
  const roundLength = (size) => {
    const power = 10 ** Math.floor(Math.log10(size));
    return [5, 2, 1].map((each) => each * power).find((each) => each <= size) || power;
  };

  const drawScene = (svg, scene, view) => {
    const [turn, tilt] = view;
    const [ct, st, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    const scale = (0.44 * VIEW) / scene.radius;
    const seen = (point) => {
      const [x, y, z] = plus(point, scene.centre, -1);
      const right = -st * x + ct * y;
      const ahead = ct * x + st * y;
      return [VIEW / 2 + scale * right, VIEW / 2 - scale * (cp * z - sp * ahead)];
    };
    svg.replaceChildren();
    for (const line of scene.lines) {
      svg.append(
        element("polyline", {
          points: line.points.map((each) => seen(each).map((v) => v.toFixed(1)).join(",")).join(" "),
          fill: "none",
          style: `stroke: var(--${line.colour})`,
          "stroke-width": line.colour === "faint" ? 0.7 : 1.8,
          "stroke-dasharray": line.dashed ? "4 3" : line.dotted ? "1 3" : "none",
        })
      );
    }
    for (const label of scene.labels) {
      const [x, y] = seen(label.at);
      const beside = {
        on: { x, y: y + 4, "text-anchor": "middle" },
        left: { x: x - 8, y: y - 8, "text-anchor": "end" },
        right: { x: x + 8, y: y - 8 },
      }[label.place || (x > 0.6 * VIEW ? "left" : "right")];
      svg.append(element("text", beside, label.text));
    }
    const bar = roundLength(0.5 * scene.radius);
    svg.append(
      element("line", {
        x1: 12, x2: 12 + bar * scale, y1: VIEW - 14, y2: VIEW - 14, style: "stroke: var(--ink)", "stroke-width": 2,
      })
    );
    svg.append(element("text", { x: 12, y: VIEW - 20 }, `${+(bar * 1e3).toPrecision(3)} mm`));
  };

  const mountView = (place) => {
    const mount = data.mounts[place.dataset.mount];
    let view = [0.7, 0.5];
    const panes = [overall(mount), closeUp(mount)].filter(Boolean).map((scene) => {
      const svg = element("svg", { viewBox: `0 0 ${VIEW} ${VIEW}`, tabindex: 0, role: "img" });
      svg.setAttribute("aria-label", `${mount.child} in ${mount.parent}, 3D view; arrow keys turn it`);
      place.append(svg);
      return { svg, scene };
    });
    const draw = () => panes.forEach(({ svg, scene }) => drawScene(svg, scene, view));
    const turnBy = (a, b) => {
      view = [view[0] + a, Math.max(-1.57, Math.min(1.57, view[1] + b))];
      draw();
    };
    const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    for (const { svg } of panes) {
      svg.addEventListener("pointermove", (event) => {
        if (event.buttons) turnBy(-event.movementX * 0.01, event.movementY * 0.01);
      });
      svg.addEventListener("pointerdown", (event) => svg.setPointerCapture(event.pointerId));
      svg.addEventListener("keydown", (event) => {
        if (!keys[event.key]) return;
        event.preventDefault();
        turnBy(...keys[event.key]);
      });
    }
    draw();
  };

  // ---- copying ----------------------------------------------------------------------------

  const copyText = async (pre) => {
    try {
      await navigator.clipboard.writeText(pre.textContent);
    } catch {
      // Without the clipboard's permission: select, and copy as Ctrl+C does.
      getSelection().selectAllChildren(pre);
      document.execCommand("copy");
    }
  };

  for (const button of document.querySelectorAll(".copy button")) {
    button.addEventListener("click", async () => {
      await copyText(button.parentElement.querySelector("pre"));
      button.textContent = "Copied";
      setTimeout(() => (button.textContent = "Copy"), 1500);
    });
  }

  // ---- start ------------------------------------------------------------------------------

  document.querySelectorAll("[data-mount]").forEach(mountView);
  document.querySelectorAll("[data-plot]").forEach(make);
  for (const { u } of plots) u.setScale("x", wholeRange(u));
  let pending = 0;
  addEventListener("resize", () => {
    cancelAnimationFrame(pending);
    pending = requestAnimationFrame(() => redraw());
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraw());
  addEventListener("beforeprint", () => redraw(680));
  addEventListener("afterprint", () => redraw());
})();
