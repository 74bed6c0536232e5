// Sliders that move the hand's joints and the object, and what to write into a task file for where they stand.
(() => {
  const { data, find, add, node, Vector } = dh, Matrix = node("stage").matrix.constructor;
  const turn = (axis, angle) => new Matrix().makeRotationAxis(new Vector(...axis), angle);
  find("#dh-card h1").textContent = data.title;
  find("#dh-card .dh-sub").textContent = data.note;
  const sliders = [], degrees = 180 / Math.PI;
  function slider(parent, name, low, high, home, unit) {
    const label = add(parent, "label");
    add(label, "span", { title: name }, name);
    const input = add(label, "input", { type: "range", min: low, max: high, step: "any", "aria-label": name });
    const output = add(label, "output");
    input.value = home;
    input.addEventListener("input", () => { output.textContent = `${(+input.value).toFixed(0)} ${unit}`; move(); });
    sliders.push({ input, home });
    output.textContent = `${home.toFixed(0)} ${unit}`;
    return input;
  }
  const heading = (text, color) => add(add(find("#dh-sliders"), "h2"), "i", color ? { style: `background: ${color}` } : {})
    .after(text);
  const joints = [];
  data.tips.forEach(({ name, color }, i) => {
    heading(name, color);
    data.joints.forEach((j, k) => {
      const unit = j.mm ? 1000 : degrees;
      if (j.finger === i)
        joints[k] = slider(find("#dh-sliders"), j.name, j.lower * unit, j.upper * unit, j.home * unit, j.mm ? "mm" : "\u00b0");
    });
  });
  const pose = [];
  if (data.X_WO) {
    heading("object");
    const R = data.X_WO, p = R.slice(12, 15).map((v) => 1000 * v); // rotations about the fixed axes x, y, z
    const rpy = [Math.atan2(R[6], R[10]), Math.asin(Math.max(-1, Math.min(1, -R[2]))), Math.atan2(R[1], R[0])];
    ["x", "y", "z"].forEach((name, i) => pose.push(slider(find("#dh-sliders"), name, p[i] - 100, p[i] + 100, p[i], "mm")));
    ["roll", "pitch", "yaw"].forEach((name, i) =>
      pose.push(slider(find("#dh-sliders"), name, -180, 180, rpy[i] * degrees, "\u00b0")));
  }
  function move() {
    const q = data.joints.map((j, k) => +joints[k].value / (j.mm ? 1000 : degrees)), X_W = [];
    data.links.forEach((link, i) => {
      const X = new Matrix().fromArray(link.X);
      if (link.parent >= 0) X.premultiply(X_W[link.parent]);
      if (link.axis) {
        const at = link.gain * q[link.joint] + link.offset;
        X.multiply(link.prismatic ? new Matrix().makeTranslation(...link.axis.map((a) => a * at)) : turn(link.axis, at));
      }
      X_W[i] = X;
      const o = node(`stage/hand/${link.name}`);
      X.decompose(o.position, o.quaternion, o.scale);
    });
    const round = (v) => Math.round(v), lines = [];
    if (pose.length) {
      const [x, y, z, a, b, c] = pose.map((input) => +input.value), o = node("stage/object");
      const X = turn([0, 0, 1], c / degrees).multiply(turn([0, 1, 0], b / degrees)).multiply(turn([1, 0, 0], a / degrees));
      X.setPosition(x / 1000, y / 1000, z / 1000).decompose(o.position, o.quaternion, o.scale);
      lines.push(`start: {xyz_mm: [${[x, y, z].map(round).join(", ")}], rpy_deg: [${[a, b, c].map(round).join(", ")}]}`);
    } else lines.push("joints_deg: {" + data.joints.map((j, k) => `${j.name}: ${round(joints[k].value)}`).join(", ") + "}");
    find("#dh-yaml").textContent = lines.join("\n");
    viewer.set_dirty();
  }
  const home = () => sliders.forEach(({ input, home }) => { input.value = home; input.dispatchEvent(new Event("input")); });
  const reach = () => dh.toggle("stage/reach");
  find("#dh-home").addEventListener("click", home);
  find("#dh-reach").addEventListener("click", reach);
  dh.bind([["h", "home", home], ["w", "where the fingertips reach", reach], ["a", "axes and paths", () => dh.toggle("stage/ways")]]);
  if (data.blocked) dh.blocked(data.blocked);
  move();
  dh.overlay();
  dh.settle([0]);
})();
