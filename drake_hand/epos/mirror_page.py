"""The mirror's page: meshcat's view, and beside it a panel with every joint's numbers."""

PAGE = """<!doctype html>
<meta charset="utf-8">
<title>drake_hand mirror</title>
<link rel="icon" href="data:,">
<style>
  body { margin: 0; display: flex; height: 100vh; font: 13px/1.45 system-ui, sans-serif; color: #222; }
  iframe { flex: 1; border: 0; }
  aside { width: 27em; padding: 0 1em; overflow: auto; background: #f6f7f8; }
  h1 { font-size: 1.1em; min-height: 2.9em; }
  table { border-collapse: collapse; width: 100%; }
  th { text-align: right; font-weight: 600; } th:first-child, td:first-child { text-align: left; }
  td, th { padding: 1px 4px; }
  td { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
</style>
<iframe src="/static/" title="both hands"></iframe>
<aside>
  <h1 id="words">listening</h1>
  <table>
    <thead><tr><th>joint<th>told<th>is<th>off deg<th>drive</tr></thead>
    <tbody id="rows"></tbody>
  </table>
  <p>solid: measured; blue ghost: commanded; green ghost: the twin, where there is one</p>
</aside>
<script>
  const scene = document.querySelector("iframe");
  scene.addEventListener("load", () => { // without Meshcat's own controls
    scene.contentDocument.head.insertAdjacentHTML("beforeend", "<style>.dg { display: none }</style>");
  });
  const cell = (text, colour) => {
    const td = document.createElement("td");
    td.textContent = text === null ? "-" : typeof text === "number" ? text.toFixed(1) : text;
    if (colour) td.style.background = colour;
    return td;
  };
  async function look() {
    try {
      const state = await (await fetch("/state")).json();
      document.getElementById("words").textContent = state.words || "listening";
      document.getElementById("rows").replaceChildren(...(state.rows || []).map(row => {
        const tr = document.createElement("tr");
        const share = Math.min((row[3] || 0) / state.red_deg, 1);
        tr.append(...row.map((x, i) => cell(x, i === 3 && share > 0.05 ? `rgba(217, 26, 26, ${share})` : "")));
        return tr;
      }));
    } catch { document.getElementById("words").textContent = "the mirror has ended"; }
  }
  setInterval(look, 250);
</script>
"""
