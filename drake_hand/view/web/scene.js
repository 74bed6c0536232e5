// What every page does with its Meshcat scene: light, floor, materials, camera, labels, keys. Fills `dh`.
const dh = (() => {
  const find = (selector) => document.querySelector(selector);
  const add = (parent, tag, attributes, text) => {
    const svg = tag === "svg" || parent.namespaceURI.endsWith("svg");
    const node = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
    for (const [key, value] of Object.entries(attributes || {})) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    return parent.appendChild(node);
  };
  const data = JSON.parse(find("#dh-data").textContent);
  const node = (path) => viewer.scene_tree.find(path.split("/")).object;
  const Vector = viewer.controls.target.constructor;
  viewer.gui.hide();
  document.title = data.title;

  // Scene coordinates have z up, the world of the renderer y.
  const world = (v) => new Vector(v[0], v[2], -v[1]);
  const looks = {
    view: world(data.look.front).multiplyScalar(1).add(world(data.look.side).multiplyScalar(.55)).add(new Vector(0, .6, 0)),
    palm: world(data.look.palm), side: world(data.look.side).add(new Vector(0, .12, 0)),
    top: world(data.look.front).multiplyScalar(.15).add(new Vector(0, 1, 0)),
  };

  function corners(roots) {
    const found = [];
    for (const root of roots) {
      root.updateWorldMatrix(true, true);
      root.traverseVisible((o) => {
        if (!o.isMesh || !o.geometry.attributes.position) return;
        o.geometry.boundingBox || o.geometry.computeBoundingBox();
        const { min, max } = o.geometry.boundingBox;
        for (let i = 0; i < 8; i++)
          found.push(new Vector(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z).applyMatrix4(o.matrixWorld));
      });
    }
    return found;
  }

  let points = [], centre = new Vector(), size = .2, moved = false, look = "view", follow = false, last = null;
  function free() { // what card and dock leave of the window, in pixels
    const w = innerWidth, h = innerHeight, card = find("#dh-card").getBoundingClientRect(), dock = find("#dh-dock");
    const bottom = dock ? h - dock.getBoundingClientRect().top : 0, wide = card.width > .6 * w;
    if (wide && !dock) return { left: 0, top: 0, right: w, bottom: card.top };
    return { left: wide ? 0 : card.right, top: wide ? card.bottom : 0, right: w, bottom: h - bottom };
  }
  function shift() { // the optical axis goes through the middle of what is free
    const r = free(), w = innerWidth, h = innerHeight;
    viewer.camera.setViewOffset(w, h, (w - r.left - r.right) / 2, (h - r.top - r.bottom) / 2, w, h);
    const scale = find("#dh-scale");
    if (scale) scale.style.bottom = `${h - r.bottom + 10}px`;
    viewer.set_dirty();
  }
  function fit(name) {
    look = name || look;
    moved = false;
    if (!points.length) return;
    const camera = viewer.camera, r = free(), away = looks[look].clone().normalize();
    camera.fov = 32;
    camera.near = size / 100;
    camera.far = size * 60;
    const right = new Vector(0, 1, 0).cross(away).normalize(), up = away.clone().cross(right);
    const tall = Math.tan(camera.fov * Math.PI / 360), wide = tall * innerWidth / innerHeight;
    const kx = .93 * wide * (r.right - r.left) / innerWidth, ky = .93 * tall * (r.bottom - r.top) / innerHeight;
    const target = centre.clone(), p = new Vector();
    let distance = 0;
    for (let round = 0; round < 6; round++) {
      distance = 0;
      for (const q of points) {
        p.copy(q).sub(target);
        distance = Math.max(distance, p.dot(away) + Math.max(Math.abs(p.dot(right)) / kx, Math.abs(p.dot(up)) / ky));
      }
      let [x0, x1, y0, y1] = [1e9, -1e9, 1e9, -1e9];
      for (const q of points) {
        p.copy(q).sub(target);
        const depth = distance - p.dot(away), x = p.dot(right) / depth, y = p.dot(up) / depth;
        [x0, x1, y0, y1] = [Math.min(x0, x), Math.max(x1, x), Math.min(y0, y), Math.max(y1, y)];
      }
      target.addScaledVector(right, (x0 + x1) / 2 * distance).addScaledVector(up, (y0 + y1) / 2 * distance);
    }
    camera.position.copy(target).addScaledVector(away, distance);
    viewer.controls.target.copy(target);
    viewer.controls.update();
    shift();
  }
  viewer.controls.addEventListener("start", () => { moved = true; });
  addEventListener("resize", () => setTimeout(() => moved ? shift() : fit(), 0));

  // A hand whose materials are missing or black would be a silhouette.
  function materials() {
    node("stage/hand").traverse((o) => {
      for (const m of [o.material].flat()) {
        if (!m || !m.color || m.map || m.vertexColors || m.dhSeen) continue;
        m.dhSeen = true;
        if (.2126 * m.color.r + .7152 * m.color.g + .0722 * m.color.b < .015) m.color.setRGB(.085, .1, .125);
        if ("roughness" in m) { m.roughness = .55; m.metalness = 0; }
        if ("shininess" in m) { m.shininess = 40; m.specular.setRGB(.12, .12, .12); }
      }
    });
  }
  function stageSet() { // light, shadow and floor, fitted to what there is
    const low = Math.min(...points.map((p) => p.y)), light = node("Lights/SpotLight/<object>");
    const span = Math.max(...points.map((p) => Math.hypot(p.x - centre.x, p.z - centre.z)));
    const floor = node("floor");
    floor.position.set(centre.x, -centre.z, low - .02 * size);
    floor.scale.set(1.25 * span, 1.25 * span, 1);
    const away = 4 * size;
    light.position.set(centre.x + .30 * away, -centre.z - .18 * away, centre.y + away);
    viewer.scene.add(light.target);
    light.target.position.set(centre.x, -centre.z, centre.y);
    Object.assign(light, { castShadow: true, angle: 1.3 * Math.atan(size / away), penumbra: .5, decay: 2, intensity: 2.4 * away * away });
    Object.assign(light.shadow, { bias: -.0004, normalBias: .004 * size, radius: 5 });
    light.shadow.mapSize.set(1024, 1024);
    light.shadow.camera.near = away / 3;
    light.shadow.camera.far = away * 2;
    light.shadow.needsUpdate = true;
    node("Lights/SpotLight").visible = true;
    for (const path of ["stage/object/contacts", "stage/object/forces", "stage/object/ways", "stage/ways", "stage/ghost"])
      node(path).traverse((o) => { o.castShadow = o.receiveShadow = false; });
  }
  function measure(times) {
    const roots = ["stage/hand", "stage/object", "stage/ways"].map(node);
    const before = dh.now ? dh.now() : 0, playing = viewer.animator.playing;
    points = [];
    for (const t of times) {
      if (dh.now) viewer.animator.seek(t);
      points.push(...corners(roots));
    }
    if (dh.now) viewer.animator.seek(playing ? 0 : before);
    if (!points.length) return;
    const range = (axis) => [Math.min(...points.map((p) => p[axis])), Math.max(...points.map((p) => p[axis]))];
    const [x, y, z] = ["x", "y", "z"].map(range);
    centre = new Vector((x[0] + x[1]) / 2, (y[0] + y[1]) / 2, (z[0] + z[1]) / 2);
    size = Math.max(...points.map((p) => p.distanceTo(centre)));
    materials();
    stageSet();
    if (!moved) fit();
  }

  // Meshes arrive one by one.
  let meshes = -1, patience = 8;
  function settle(times) {
    let n = 0;
    node("stage").traverse((o) => { n += o.isMesh ? 1 : 0; });
    if (n !== meshes) { meshes = n; patience = 8; measure(times); }
    if (--patience) return setTimeout(settle, 150, times);
    dh.ready = true;
    find("#dh-loading").remove();
  }

  // Names at the fingertips.
  const named = [...data.tips, ...(data.labels || [])];
  const labels = named.map(({ name, color }, i) => {
    const label = add(find("#dh-labels"), "div", { style: `background: ${color}` },
      data.numbered && i < data.tips.length ? `${i + 1} ${name}` : name);
    label.addEventListener("click", () => dh.pick && i < data.tips.length && dh.pick(i));
    return label;
  });
  let labelled = innerWidth > 700;
  function place({ path, p }) { // of a point of the scene in the window, in pixels
    const at = new Vector(...p), o = node(path);
    o.updateWorldMatrix(true, false);
    viewer.camera.updateMatrixWorld();
    at.applyMatrix4(o.matrixWorld).project(viewer.camera);
    return [(at.x + 1) / 2 * innerWidth, (1 - at.y) / 2 * innerHeight];
  }
  function name() { // the points, no name over another
    const put = [];
    const wanted = named.map((point, i) => [labels[i], ...place(point)]).sort((a, b) => a[2] - b[2]);
    for (const [label, px, py] of wanted) {
      label.hidden = !labelled;
      const wide = label.offsetWidth, tall = label.offsetHeight, x = Math.min(px + 9, innerWidth - wide);
      let y = py - 20;
      for (const [left, top, right, bottom] of put)
        if (x < right && x + wide > left && y < bottom && y + tall > top) y = bottom;
      put.push([x, y, x + wide, y + tall]);
      label.style.transform = `translate(${x}px, ${y}px)`;
    }
  }
  function overlay() {
    const floor = node("floor"), camera = viewer.camera;
    floor.visible = camera.position.y > floor.position.z;
    name();
    const scale = find("#dh-scale");
    if (scale) {
      const metre = innerHeight / (2 * Math.tan(camera.fov * Math.PI / 360) * camera.position.distanceTo(viewer.controls.target));
      const newton = data.force.m_per_n * metre, unit = 10 ** Math.floor(Math.log10(70 / newton));
      const shown = [5, 2, 1].map((k) => k * unit).find((n) => n * newton <= 70) || unit;
      scale.querySelector("i").style.width = `${shown * newton}px`;
      scale.querySelector("span").textContent = `${+shown.toPrecision(2)} N`;
    }
    if (follow) {
      const p = new Vector().setFromMatrixPosition(node("stage/object").matrixWorld);
      if (last) {
        camera.position.add(p).sub(last);
        viewer.controls.target.add(p).sub(last);
      }
      last = p;
    }
    requestAnimationFrame(overlay);
  }
  function blocked(finger) {
    const label = labels[data.tips.findIndex(({ name }) => name === finger)];
    if (label) Object.assign(label, { textContent: `${finger} blocks` }).style.background = "#b3261e";
  }
  const toggle = (path) => { const o = node(path); o.visible = !o.visible; viewer.set_dirty(); };

  // Keys, which are buttons of the help as well.
  const keys = [
    ["1", "camera: as at first", () => fit("view")], ["2", "camera: on the palm", () => fit("palm")],
    ["3", "camera: from the side", () => fit("side")], ["4", "camera: from above", () => fit("top")],
    ["f", "camera follows the object", () => { follow = !follow; last = null; moved = true; }],
    ["l", "names of the fingers", () => { labelled = !labelled; }],
  ];
  const help = () => { find("#dh-help").hidden = !find("#dh-help").hidden; };
  function bind(more) {
    const table = add(find("#dh-help"), "table");
    for (const [key, words, act] of [...more, ...keys, ["?", "this list", help]]) {
      const row = add(table, "tr"), names = { " ": "space", ArrowLeft: "\u2190", ArrowRight: "\u2192" };
      add(add(row, "td"), "kbd", {}, names[key] || key);
      add(add(row, "td"), "button", {}, words).addEventListener("click", act);
      addEventListener("keydown", (e) => {
        if (e.key !== key || e.ctrlKey || e.metaKey || e.target.closest?.("input, select")) return;
        act(e);
        e.preventDefault();
      });
    }
    addEventListener("keydown", (e) => { if (e.key === "Escape") find("#dh-help").hidden = true; });
    find("#dh-ask").addEventListener("click", help);
  }
  return { data, find, add, node, Vector, place, fit, shift, settle, bind, toggle, blocked, overlay, corners, camera: () => look, ready: false };
})();
