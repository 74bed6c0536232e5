// The panel of a plan: play, scrub, mode, timeline, strips.
(() => {
  const { data, find, add, node } = dh, animator = viewer.animator;
  Object.assign(find("#dh-card h1"), { textContent: data.title, title: data.title });
  find("#dh-card .dh-sub").textContent = data.subtitle + " ";
  add(find("#dh-card .dh-sub"), "span", { class: "dh-badge dh-" + data.good }, data.badge);
  find("#dh-more summary").textContent = data.verdict;
  find("#dh-more").open = innerWidth > 700 && innerHeight > 520;
  find("#dh-scale").hidden = !data.force.most_n;
  const digits = data.tips.map(({ name, color }, i) => {
    const box = add(find("#dh-mode"), "div", { title: name }), digit = add(box, "b");
    add(box, "span", { style: `border-color: ${color}` }, name);
    box.addEventListener("click", () => dh.pick(i));
    return digit;
  });
  if (data.facts.some((f) => f[2]))
    for (const text of ["", "value", "margin"]) add(find("#dh-facts"), "b", {}, text);
  for (const [name, value, margin, fine] of data.facts)
    for (const text of [name, value, margin]) add(find("#dh-facts"), "span", fine ? {} : { class: "dh-no" }, text);

  // The timeline: a row per finger, thumb on top, strips below; redrawn when the window changes.
  let cursor, width, chosen = null, em = 14;
  const LEFT = () => 6.2 * em, x = (t) => LEFT() + (width - LEFT() - .7 * em) * t / data.duration;
  const round = ({ low, high }, v) => +v.toFixed(high - low < 1 ? 2 : high - low < 9 ? 1 : 0);
  const at = (values, t) => values[Math.round(t / data.duration * (values.length - 1))];
  function draw() {
    const line = find("#dh-line");
    line.replaceChildren();
    em = parseFloat(getComputedStyle(find("#dh-dock")).fontSize);
    width = line.clientWidth;
    const small = innerHeight < 520, ROW = 1.12 * em, CHART = (small ? 1.2 : 2.3) * em, n = data.tips.length;
    const bars = ROW * n, height = bars + (CHART + .3 * em) * data.strips.length + 1.3 * em;
    const svg = add(line, "svg", { viewBox: `0 0 ${width} ${height}`, height });
    data.tips.forEach(({ name, color }, i) => {
      const y = ROW * (n - 1 - i);
      add(svg, "text", { x: LEFT() - 1.3 * em, y: y + .9 * em, "text-anchor": "end" }, name);
      add(svg, "circle", { cx: LEFT() - .65 * em, cy: y + .55 * em, r: .32 * em, fill: color });
      data.rows[i].forEach(([digit, start, end], k) => {
        const strong = chosen && chosen[0] === i && chosen[1] === k;
        add(svg, "rect", { x: x(start), y: y + 1, width: Math.max(x(end) - x(start), .5), height: ROW - 2.5,
          fill: `var(--${["free", "roll", "slide"][digit]})`, class: "dh-bar",
          ...(strong ? { stroke: "#111", "stroke-width": 2 } : {}) });
      });
    });
    data.strips.forEach((strip, k) => {
      const { name, unit, values, low, high, limit } = strip;
      const top = bars + .3 * em + k * (CHART + .3 * em), y = (v) => top + CHART * (high - v) / (high - low);
      add(svg, "rect", { x: x(0), y: top, width: x(data.duration) - x(0), height: CHART, fill: "#f4f6f9" });
      if (limit !== null)
        add(svg, "line", { x1: x(0), x2: x(data.duration), y1: y(limit), y2: y(limit), stroke: "#b3261e", "stroke-dasharray": "4 3" });
      let path = "", pen = "M";
      values.forEach((v, i) => {
        if (v === null) { pen = "M"; return; }
        path += `${pen}${x(i * data.duration / (values.length - 1)).toFixed(1)} ${y(v).toFixed(1)}`;
        pen = "L";
      });
      add(svg, "path", { d: path, fill: "none", stroke: "#1d2430", "stroke-width": 1.3 });
      add(svg, "text", { x: LEFT() - .4 * em, y: top + .8 * em, "text-anchor": "end" }, name);
      if (!small) add(svg, "text", { x: LEFT() - .4 * em, y: top + CHART - .15 * em, "text-anchor": "end" },
        `${round(strip, low)} \u2026 ${round(strip, high)} ${unit}`);
    });
    const raw = data.duration / Math.max(2, width / (6 * em)), unit = 10 ** Math.floor(Math.log10(raw));
    const step = unit * [1, 2, 5, 10].find((k) => k * unit >= raw);
    for (let t = 0; t <= data.duration + 1e-9; t += step)
      add(svg, "text", { x: x(t), y: height - .2 * em, "text-anchor": "middle" }, +t.toFixed(3) + (t ? "" : " s"));
    cursor = add(svg, "rect", { y: 0, width: 2, height: height - 1.3 * em, fill: "#d11" });
    shown = null;
    const wide = innerWidth > 700 && !small; // the card ends above the dock
    find("#dh-card").style.maxHeight = wide ? `${find("#dh-dock").getBoundingClientRect().top - 2 * em}px` : "";
    dh.shift();
  }
  dh.pick = (finger, t = now()) => {
    const k = data.rows[finger].findIndex(([, , end]) => t < end);
    chosen = [finger, k < 0 ? data.rows[finger].length - 1 : k];
    find("#dh-detail").textContent = data.rows[finger][chosen[1]][3];
    draw();
  };

  const line = find("#dh-line");
  function seek(event, picks) {
    const box = line.getBoundingClientRect(), row = Math.floor((event.clientY - box.top) / (1.12 * em));
    const t = Math.max(0, Math.min(data.duration, (event.clientX - box.left - LEFT()) / (width - LEFT() - .7 * em) * data.duration));
    animator.seek(t);
    if (picks && row >= 0 && row < data.tips.length) dh.pick(data.tips.length - 1 - row, t);
  }
  line.addEventListener("pointerdown", (e) => { line.setPointerCapture(e.pointerId); toggle(false); seek(e, true); });
  line.addEventListener("pointermove", (e) => { if (e.buttons) seek(e, false); });
  const pane = viewer.renderer.domElement.parentElement; // it captures the pointer, so clicks go to it
  pane.addEventListener("click", (e) => { // on a fingertip
    const far = data.tips.map(dh.place).map(([x, y]) => Math.hypot(x - e.clientX, y - e.clientY));
    const nearest = far.indexOf(Math.min(...far));
    if (far[nearest] < 2 * em) dh.pick(nearest);
  });

  function toggle(on) {
    if (on === animator.playing) return;
    if (on && now() > data.duration - .05) animator.seek(0);
    on ? animator.play() : animator.pause();
  }
  const jump = (t) => { toggle(false); animator.seek(Math.max(0, Math.min(data.duration, t))); };
  const events = [0, ...data.parts.slice(0, -1).map((p) => p.end), data.duration];
  const loop = () => find("#dh-loop").setAttribute("aria-pressed", find("#dh-loop").ariaPressed !== "true");
  function speed(step) {
    const select = find("#dh-speed");
    select.selectedIndex = Math.max(0, Math.min(select.options.length - 1, select.selectedIndex + step));
    animator.mixer.timeScale = +select.value;
  }
  find("#dh-play").addEventListener("click", () => toggle(!animator.playing));
  find("#dh-loop").addEventListener("click", loop);
  find("#dh-speed").addEventListener("change", (e) => { speed(0); e.target.blur(); });
  dh.bind([
    [" ", "play or pause", () => toggle(!animator.playing)],
    ["ArrowLeft", "a frame back", () => jump(now() - 1 / 30)], ["ArrowRight", "a frame on", () => jump(now() + 1 / 30)],
    ["[", "to the event before", () => jump(events.filter((t) => t < now() - 1e-3).pop() ?? 0)],
    ["]", "to the next event", () => jump(events.find((t) => t > now() + 1e-3) ?? data.duration)],
    ["-", "slower", () => speed(-1)], ["+", "faster", () => speed(1)], ["r", "again and again", loop],
    ["t", "paths of the contacts", () => ["stage/object/ways", "stage/ways"].forEach(dh.toggle)],
    ...(data.ghost ? [["g", "where the object should be, faint", () => dh.toggle("stage/ghost")]] : []),
  ]);
  addEventListener("resize", draw);

  const now = dh.now = () => animator.actions.reduce((latest, action) => Math.max(latest, action.time), 0);
  // Where frames come slowly, as drawn in software, motion is drawn coarser; what rests is drawn fine.
  const fine = viewer.renderer.getPixelRatio(), SLOW_MS = 90, COARSEST = .3;
  let coarse = 1, frame = 0, frames = [];
  function pace(stamp) {
    frames = animator.playing ? [...frames.slice(-2), stamp - frame] : [];
    frame = stamp;
    const slow = frames.length === 3 && frames.every((ms) => ms > SLOW_MS);
    const next = !animator.playing ? 1 : slow ? Math.max(COARSEST, .6 * coarse) : coarse;
    if (next === coarse) return;
    coarse = next;
    frames = [];
    viewer.renderer.setPixelRatio(fine * coarse); // empties the picture
    viewer.render();
  }

  function stuck() { // where planning got no further, with the finger that blocks
    animator.pause();
    animator.seek(data.stop.t);
    const finger = data.tips.findIndex(({ name }) => name === data.stop.finger);
    if (finger < 0) return;
    dh.blocked(data.stop.finger);
    dh.pick(finger);
  }

  let shown = null, part = -1, playing = null, mixer = null, ended = false;
  function follow(stamp) {
    requestAnimationFrame(follow);
    pace(stamp);
    if (!dh.begun) { // what plays is seen from its start
      dh.begun = dh.ready && animator.actions.length > 0;
      if (dh.begun && data.stop) stuck();
      else if (dh.begun) { animator.seek(0); animator.play(); } else if (animator.playing) animator.pause();
    }
    if (mixer !== animator.mixer) {
      mixer = animator.mixer;
      mixer.addEventListener("finished", () => { ended = true; });
    }
    if (ended && !animator.playing) { // Meshcat sets its clock back there, but not the scene.
      ended = false;
      animator.seek(data.duration);
      if (find("#dh-loop").ariaPressed === "true") toggle(true);
    }
    const t = Math.min(now(), data.duration);
    if (playing !== animator.playing) {
      playing = animator.playing;
      find("#dh-play").textContent = playing ? "\u275a\u275a" : "\u25b6";
    }
    if (t === shown) return;
    shown = t;
    find("#dh-time").textContent = `${t.toFixed(2)} s`;
    cursor.setAttribute("x", x(t) - 1);
    find("#dh-now").textContent = data.strips.filter((s) => at(s.values, t) !== null)
      .map((s) => `${s.name} ${at(s.values, t).toFixed(s.high - s.low < 9 ? 2 : 0)} ${s.unit}`).join(", ");
    for (const { path, ends, each } of data.ways) // a way grows as it is gone
      node(path).traverse((o) => { if (o.isMesh) o.geometry.setDrawRange(0, each * ends.filter((end) => end <= t).length); });
    viewer.set_dirty();
    // between pieces fingers switch for the next one
    find("#dh-step").textContent = (data.pieces.find(([end]) => t <= end) ?? data.pieces.at(-1) ?? [0, ""])[1];
    let i = data.parts.findIndex((p) => t < p.end);
    if (i < 0) i = data.parts.length - 1;
    if (i === part) return;
    part = i;
    [...data.parts[i].mode].forEach((digit, k) => { digits[k].textContent = digit; digits[k].className = "dh-" + digit; });
    find("#dh-event").textContent =
      `part ${i} of 0 \u2026 ${data.parts.length - 1}` + (data.parts[i].events.length ? ": " + data.parts[i].events.join(", ") : "");
  }
  draw();
  follow(0);
  dh.overlay();
  dh.settle([0, 1, 2, 3, 4].map((k) => k * data.duration / 4));
})();
