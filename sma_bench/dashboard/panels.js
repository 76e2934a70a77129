// What stands beside the plots. Text only ever enters the page as text.

const SILENT = 1.5; // s
const NODE_SILENT = 4.0; // s; diagnostics come once a second

export function element(tag, text = "", className = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = className;
  return made;
}

// A name that may be broken at its dots and underlines, numbers and options that may not.
function broken(tag, name) {
  const made = element(tag);
  for (const part of name.split(/(?<=[._])/)) made.append(part, document.createElement("wbr"));
  return made;
}

function kept(tag, text, className = "") {
  const made = element(tag, "", className);
  for (const [k, part] of text.split(/(--[a-z][\w-]*|[\d.]+e-\d+)/).entries()) {
    made.append(k % 2 ? element("span", part, "keep") : part);
  }
  return made;
}

const line = (text) => kept("p", text, "quiet");

// Places once each: channels as the bench counts them, then the others by name.
export function inOrder(places, panels) {
  const channels = panels.channels || [];
  const rank = (place) => (channels.includes(place) ? channels.indexOf(place) : channels.length);
  return [...new Set(places)].sort((a, b) => rank(a) - rank(b) || a.localeCompare(b));
}

const get = (id) => document.getElementById(id);

export function showProtocol(panels, now) {
  const progress = panels.progress;
  if (!progress) return;
  const state = (panels.states || {})[progress.node] || "";
  const there = (panels.there || []).includes(progress.node);
  const running = state.startsWith("running") && there;
  const { duration, elapsed } = progress;
  const whole = duration ? ` of ${duration.toFixed(0)} s` : " s";
  let text = running ? `${progress.protocol}, ${progress.step}: ${elapsed.toFixed(1)}${whole}` : state;
  const late = running && now - progress.heard > SILENT;
  if (late) text += ` \u2013 silent for ${(now - progress.heard).toFixed(0)} s`;
  if (!there) text = `${progress.node} is not there any more (last: ${state})`;
  get("protocol-text").textContent = text;
  get("protocol-text").className = late || !there || state.startsWith("aborted") ? "silent" : "";
  get("protocol-bar").hidden = !duration || !running;
  if (duration) get("protocol-bar").value = Math.min(1, elapsed / duration);
}

export function showMeters(signals, panels, now) {
  const limits = panels.limits || { values: {}, of: [] };
  const limit = limits.values.temperature;
  get("heat-limit").textContent =
    limit === undefined
      ? "no node tells its limit"
      : `limit ${limit.toFixed(1)} \u00b0C, of ${limits.of.join(", ")}`;
  const wires = signals.filter(
    (s) => s.quantity === "temperature" && s.kind === "measured" && s.place !== "ambient",
  );
  if (!wires.length) return;
  const order = inOrder(wires.map((wire) => wire.place), panels);
  wires.sort((a, b) => order.indexOf(a.place) - order.indexOf(b.place));
  get("meters").replaceChildren(
    ...wires.map(({ place, latest, heard }) => {
      const row = element("div", "", "meter");
      const track = element("div", "", "track");
      const fill = element("div", "", "fill");
      const silent = now - heard > SILENT || latest === null;
      const share = silent || !limit ? 0 : Math.max(0, Math.min(1, latest / limit));
      fill.style.width = `${100 * share}%`;
      if (limit && !silent) row.classList.toggle("over", latest > limit);
      if (limit && !silent) row.classList.toggle("near", latest > 0.9 * limit && latest <= limit);
      const over = limit && !silent && latest > limit ? " over" : "";
      const text = silent ? `silent ${(now - heard).toFixed(0)} s` : `${latest.toFixed(1)} \u00b0C${over}`;
      track.append(fill);
      row.append(element("span", place), track, element("span", text, silent ? "value silent" : "value"));
      return row;
    }),
  );
}

export function showNodes(panels, now) {
  const there = panels.there || [];
  const rows = Object.entries(panels.states || {}).map(([node, state]) => {
    const gone = !there.includes(node);
    const bad = gone || /^(stopped|still flowing|aborted|not connected|failed)/.test(state);
    return [node, gone ? `gone (last: ${state})` : state, bad ? "error" : ""];
  });
  for (const [name, { level, message, heard }] of Object.entries(panels.diagnostics || {})) {
    const silent = now - heard > NODE_SILENT;
    const text = silent ? `silent for ${(now - heard).toFixed(0)} s` : message || level;
    rows.push([name, text, silent ? "error" : level]);
  }
  rows.sort((a, b) => a[0].localeCompare(b[0]));
  get("node-rows").replaceChildren(
    ...rows.map(([name, text, level]) => {
      const row = element("tr");
      row.append(element("td", name), element("td", text, level));
      return row;
    }),
  );
  const stops = panels.stops || [];
  const asked = stops.length ? `STOP asks: ${stops.join(", ")}, and commands 0 V.` :
    "STOP commands 0 V: no node here has a stop service.";
  const elsewhere = panels.elsewhere || [];
  const other = elsewhere.length ? ` Other benches: ${elsewhere.join(", ")} (--namespace).` : "";
  get("stops").textContent = asked + other;
}

export function showWork(panels) {
  const works = panels.works || [];
  get("work").hidden = !works.length;
  for (const button of get("work-form").querySelectorAll("button")) {
    button.hidden = !works.includes(button.value);
    button.disabled = false;
  }
  if (panels.recorded) get("records").placeholder = panels.recorded;
  const said = panels.work;
  if (!said) return;
  get("work-said").textContent = said.text;
  get("work-said").className = said.good ? "" : "bad";
}

export function showIdentification(panels) {
  const found = panels.identification;
  if (!found) return;
  if (found.problem) {
    get("identification-content").replaceChildren(element("p", found.problem, "error"));
    return;
  }
  const table = element("table", "", "numbers");
  table.append(...found.rows.map(([name, number]) => {
    const row = element("tr");
    row.append(broken("td", name), kept("td", number));
    return row;
  }));
  const head = element("p");
  head.append(element("strong", found.title));
  get("identification-content").replaceChildren(head, table, ...found.lines.map(line));
}

export function showDiagnosis(panels) {
  const found = panels.diagnosis;
  if (!found) return;
  if (found.problem) {
    get("diagnosis-content").replaceChildren(element("p", found.problem, "error"));
    return;
  }
  const bars = found.candidates.map(({ name, probability }) => {
    const row = element("div", "", "meter");
    const track = element("div", "", "track");
    const fill = element("div", "", "fill");
    fill.style.width = `${100 * probability}%`;
    track.append(fill);
    row.append(element("span", name.replaceAll("_", " ")), track,
      element("span", `${(100 * probability).toFixed(1)} %`, "value"));
    return row;
  });
  const head = element("p");
  head.append(element("strong", found.verdict));
  get("diagnosis-content").replaceChildren(head, ...bars, ...found.lines.map(line));
}

// Nothing here can end it: louder than all else, above the stop, until the node says otherwise.
export function showPlug(panels) {
  const flowing = Object.entries(panels.states || {}).filter(([, state]) => state.startsWith("still flowing"));
  const box = get("plug");
  if (box.dataset.said !== JSON.stringify(flowing)) {
    box.dataset.said = JSON.stringify(flowing);
    box.replaceChildren(element("strong", "PULL THE PLUG"),
      ...flowing.map(([node, state]) => element("p", `${node}: ${state}`)));
  }
  box.hidden = !flowing.length;
  document.title = document.title.replace(/^PULL THE PLUG - /, "");
  if (flowing.length) document.title = `PULL THE PLUG - ${document.title}`;
}

// After a stop that was confirmed: a voltage is news to everybody who saw that.
let told = null;

export function showAgain(panels) {
  const { again } = panels;
  if (!again || again === told) return;
  told = again;
  const volts = again.volts === null ? "a voltage" : `${again.volts.toFixed(2)} V`;
  const said = `VOLTAGE IS ON AGAIN: ${again.place} ${volts}, ${again.seconds.toFixed(1)} s after the stop.`;
  const box = get("stop-result");
  box.hidden = false;
  box.className = "bad";
  box.replaceChildren(element("p", said, "said"));
}

export function showStop(result) {
  const box = get("stop-result");
  box.hidden = false;
  box.className = result.stopped ? "ok" : "bad";
  const list = element("ul");
  for (const { node, success, message } of result.answers || []) {
    list.append(element("li", `${node}: ${success ? message : `FAILED: ${message}`}`));
  }
  const volts = Object.entries(result.voltages || {}).map(([wire, v]) => `${wire} ${v.toFixed(2)} V`);
  const parts = [element("p", result.said, "said")];
  const time = new Date().toLocaleTimeString();
  if (volts.length) parts.push(element("p", `Read at ${time}: ${volts.join(", ")}`));
  box.replaceChildren(...parts, list);
}
