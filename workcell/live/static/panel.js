// The instruments of the live page: shows what the run says, sends what the person does. The scene itself is viser's.
"use strict";
(() => {
  const BEAT_MS = 50;          // keys and sticks that are held are told this often, and that the page is alive
  const CURVE_S = 20;
  const TTC_TOP = 5;           // s, the top of the curve and of the bar
  let socket = null, hello = null, state = null, ended = null;
  let sound = false, audio = null, nextBeep = 0;
  const held = new Set();      // codes of keys and jog buttons that are down
  let slow = false, clutch = false, clutchButton = false;
  let curve = [];              // [time_s, ttc_s or null, artc]
  const by = (id) => document.getElementById(id);

  // Where a processor draws the scene, it must not take all there is: the run needs it too.
  const SOFTWARE_FRAME_MS = 150;
  function drawsInSoftware() {
    const gl = document.createElement("canvas").getContext("webgl");
    const named = gl && gl.getExtension("WEBGL_debug_renderer_info");
    return !gl || (named && /swiftshader|llvmpipe|softpipe|software|basic render/i.test(gl.getParameter(named.UNMASKED_RENDERER_WEBGL)));
  }
  if (drawsInSoftware()) {
    const frame = window.requestAnimationFrame.bind(window);
    let waiting = new Map(), count = 0, asked = false, next = 0;
    const run = (time) => {
      const now = waiting;
      waiting = new Map(); asked = false; next = performance.now() + SOFTWARE_FRAME_MS;
      for (const callback of now.values()) callback(time);
      next = performance.now() + SOFTWARE_FRAME_MS;
    };
    window.requestAnimationFrame = (callback) => {
      waiting.set(++count, callback);
      if (!asked) { asked = true; setTimeout(() => frame(run), Math.max(0, next - performance.now())); }
      return count;
    };
    window.cancelAnimationFrame = (id) => waiting.delete(id);
  }
  const el = (tag, attributes = {}, ...children) => {
    const node = Object.assign(document.createElement(tag), attributes);
    node.append(...children);
    return node;
  };
  const send = (message) => { if (socket && socket.readyState === 1) socket.send(JSON.stringify(message)); };
  const act = (action) => send({ kind: "act", action });

  function build() {
    const root = el("div", { id: "wc" },
      el("div", { id: "wc-gauge", className: "card" },
        el("div", { className: "row" }, el("span", { id: "wc-ttc", textContent: "–" }), el("span", { id: "wc-of" })),
        el("div", { id: "wc-bar" }, el("i")), el("div", { id: "wc-pair" }),
        el("canvas", { id: "wc-curve", width: 612, height: 192 }),
        el("div", { id: "wc-legend" }, el("span", { textContent: "time to collision, 20 s" }), el("span", { id: "wc-artc" })),
        el("div", { id: "wc-settings" })),
      el("div", { id: "wc-arms", className: "card" }),
      el("div", { id: "wc-side", className: "card" }),
      el("div", { id: "wc-centre", className: "card" }),
      el("div", { id: "wc-warn", className: "card wc-red" }));
    document.body.append(root);
  }

  function jog(code, label) {
    const button = el("button", { textContent: label, className: "jog" });
    button.dataset.code = code;
    const down = (event) => { event.preventDefault(); button.setPointerCapture?.(event.pointerId); held.add(code); beat(); };
    const up = () => { held.delete(code); beat(); };
    button.addEventListener("pointerdown", down);
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(name, up);
    return button;
  }

  function buildSide() {
    const side = by("wc-side");
    side.replaceChildren();
    const grid = (...nodes) => el("div", { className: "grid" }, ...nodes);
    if (!hello.driver) {
      const take = el("button", { id: "wc-take", textContent: "Drive", disabled: hello.taken, onclick: () => send({ kind: "take" }) });
      side.append(el("h3", { textContent: hello.taken ? "You watch; another browser drives" : "Nobody drives" }), take);
    } else {
      side.append(el("h3", { textContent: "Run" }), grid(...hello.actions.map((a) => {
        const button = el("button", { id: "wc-" + a.action, title: a.words, onclick: () => { act(a.action); button.blur(); } }, a.label, el("kbd", { textContent: a.key }));
        return button;
      })));
      if (hello.arms.length > 1) side.append(el("h3", { textContent: "Keys move" }), grid(...hello.arms.map((name) => {
        const button = el("button", { textContent: name, onclick: () => { send({ kind: "arm", name }); button.blur(); } });
        button.dataset.arm = name; return button;
      })));
      side.append(el("h3", { textContent: "Move (hold)" }), grid(...hello.jogs.map(([code, label]) => jog(code, label))));
      const open = el("button", { id: "wc-clutch", textContent: "Clutch", title: "The arm stands while you move the marker; closed again, the marker is back at the tool",
        onclick: () => { clutchButton = !clutchButton; open.classList.toggle("on", clutchButton); beat(); open.blur(); } });
      side.append(el("h3", { textContent: "Other" }), grid(open, el("button", { id: "wc-sound", textContent: "Sound", title: "A tone while the gauge is red", onclick: toggleSound })));
    }
    side.append(el("h3", { textContent: "Camera" }), grid(...hello.cameras.map((name) => {
      const button = el("button", { textContent: name, onclick: () => { send({ kind: "camera", name }); button.blur(); } });
      button.dataset.camera = name; return button;
    })));
    if (hello.driver) side.append(el("h3", { textContent: "Keys" }), el("table", { id: "wc-keys" },
      ...hello.keys.map(([key, words]) => el("tr", {}, el("td", { textContent: key }), el("td", { textContent: words })))));
  }

  function toggleSound() {
    sound = !sound;
    if (sound && !audio) audio = new AudioContext();
    by("wc-sound")?.classList.toggle("on", sound);
    by("wc-sound")?.blur();
  }

  function beep() {
    if (!sound || !audio || performance.now() < nextBeep) return;
    nextBeep = performance.now() + 400;
    const tone = audio.createOscillator(), volume = audio.createGain();
    volume.gain.value = 0.08; tone.frequency.value = 660;
    tone.connect(volume).connect(audio.destination);
    tone.start(); tone.stop(audio.currentTime + 0.12);
  }

  function show() {
    const s = state;
    const ttc = by("wc-ttc");
    ttc.textContent = s.ttc_words; ttc.className = "wc-" + s.colour;
    by("wc-of").textContent = s.t_min_s ? `t_min ${s.t_min_s.toFixed(2)} s` : "";
    const bar = by("wc-bar").firstChild;
    bar.style.width = `${100 * Math.min(1, s.ttc_s === null ? 1 : s.ttc_s / TTC_TOP)}%`; bar.className = "wc-" + s.colour;
    by("wc-pair").textContent = s.pair + (s.distance_m === null ? "" : `, ${(1000 * s.distance_m).toFixed(0)} mm`);
    by("wc-pair").className = "wc-" + s.colour;
    by("wc-artc").textContent = `ARTC ${s.artc_per_s.toFixed(2)} 1/s`;
    by("wc-settings").textContent = s.phase === "ready" ? "" : `${s.time_s.toFixed(1)} s, ${s.speed}; criterion ${s.criterion}; from ${s.entry || "the side in the job"}${s.recording ? "; recording a take" : ""}`;
    by("wc-arms").replaceChildren(...s.arms.map((arm) => {
      const line = el("div", {}, el("b", { textContent: arm.name + (arm.live ? " (you) " : " ") }), el("span", { className: "wc-" + arm.colour, textContent: arm.words }));
      line.dataset.arm = arm.name; return line;
    }));
    for (const button of document.querySelectorAll("#wc [data-arm]")) if (button.tagName === "BUTTON") button.classList.toggle("on", button.dataset.arm === s.selected);
    const centre = by("wc-centre");
    const cover = { ready: hello?.driver ? "Ready. Press Start, or Space." : "Not started yet.", counting: String(s.count), paused: "Paused" }[s.phase];
    centre.style.display = cover && !ended ? "block" : ended ? "block" : "none";
    if (cover && !ended) centre.replaceChildren(el("div", { className: s.phase === "counting" ? "big" : "", id: "wc-phase", textContent: cover }));
    const warn = by("wc-warn");
    const words = s.halt ? `Stopped by the final check: ${s.halt}. Press “Go on” (0) to release.` : s.slow ? `${s.speed}: this machine is too slow for the period` : "";
    warn.style.display = words ? "block" : "none"; warn.textContent = words;
    by("wc").dataset.phase = s.phase; by("wc").dataset.colour = s.colour;
    if (s.colour === "red" && s.phase === "running") beep();
  }

  function draw() {
    const canvas = by("wc-curve"), c = canvas.getContext("2d"), w = canvas.width, h = canvas.height;
    c.clearRect(0, 0, w, h);
    if (!curve.length) return;
    const last = curve[curve.length - 1][0], x = (t) => w * (1 - (last - t) / CURVE_S), y = (v) => h - 4 - (h - 8) * Math.min(1, v / TTC_TOP);
    c.strokeStyle = "#39424e"; c.lineWidth = 1; c.fillStyle = "#8b96a3"; c.font = "20px system-ui";
    for (const v of [1, 3, 5]) { c.beginPath(); c.moveTo(0, y(v)); c.lineTo(w, y(v)); c.stroke(); c.fillText(`${v} s`, 2, y(v) + (v === 5 ? 20 : -4)); }
    if (state) { c.strokeStyle = "#ff5a52"; c.setLineDash([8, 8]); c.beginPath(); c.moveTo(0, y(state.t_min_s)); c.lineTo(w, y(state.t_min_s)); c.stroke(); c.setLineDash([]); }
    const line = (value, colour) => {
      c.strokeStyle = colour; c.lineWidth = 3; c.beginPath(); let pen = false;
      for (const point of curve) { const v = value(point); if (v === null) { pen = false; continue; } pen ? c.lineTo(x(point[0]), y(v)) : c.moveTo(x(point[0]), y(v)); pen = true; }
      c.stroke();
    };
    const top = Math.max(0.5, ...curve.map((p) => Math.abs(p[2])));
    line((p) => TTC_TOP * Math.abs(p[2]) / top, "#6fb3ff");
    line((p) => p[1], "#f2f4f7");
  }

  function report(message) {
    ended = message;
    const centre = by("wc-centre");
    centre.replaceChildren(el("div", { id: "wc-phase", textContent: "The session has ended" }), el("pre", { id: "wc-report", textContent: message.text }));
    centre.style.display = "block";
    by("wc").dataset.phase = "ended";
  }

  function sticks() {
    for (const pad of navigator.getGamepads ? navigator.getGamepads() : []) {
      if (!pad || !pad.connected) continue;
      const a = pad.axes, b = (k) => (pad.buttons[k] ? pad.buttons[k].value : 0);
      if (a.length >= 6 && /space/i.test(pad.id)) return [a[0], -a[1], -a[2], a[3], -a[4], a[5]];
      return [a[0] || 0, -(a[1] || 0), -(a[3] || 0), 0, b(5) - b(4), a[2] || 0];
    }
    return null;
  }

  function beat() {
    if (!hello || !hello.driver) return;
    send({ kind: "alive", held: [...held], slow, clutch: clutch || clutchButton, axes: sticks() });
  }

  function letGo() { held.clear(); clutch = false; slow = false; beat(); }

  const typing = (event) => /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName || "");
  window.addEventListener("keydown", (event) => {
    if (!hello || typing(event) || event.ctrlKey || event.metaKey || event.altKey) return;
    slow = event.shiftKey;
    const known = hello.held.includes(event.code), action = hello.presses[event.code];
    // The keys of this page are its own: viser would move the camera with some of them.
    event.stopImmediatePropagation();
    if (!known && !action && event.code !== "KeyC") return;
    event.preventDefault();
    if (!hello.driver) return;
    if (event.code === "KeyC") { clutch = true; beat(); }
    if (known && !held.has(event.code)) { held.add(event.code); beat(); }
    if (action && !event.repeat) action === "sound" ? toggleSound() : act(action);
  }, true);
  window.addEventListener("keyup", (event) => {
    slow = event.shiftKey;
    if (event.code === "KeyC") { clutch = false; beat(); }
    if (held.delete(event.code)) beat();
    if (!typing(event)) event.stopImmediatePropagation();
  }, true);
  window.addEventListener("blur", letGo);
  document.addEventListener("visibilitychange", () => { if (document.hidden) letGo(); });

  function connect() {
    socket = new WebSocket(location.origin.replace(/^http/, "ws") + "/panel");
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.kind === "hello") { hello = message; buildSide(); beat(); }
      else if (message.kind === "history") { curve = message.curve; }
      else if (message.kind === "report") report(message);
      else if (message.kind === "state") {
        state = message;
        const last = curve.length ? curve[curve.length - 1][0] : -1;
        if (state.time_s < last) curve = [];
        if (state.time_s > last && state.phase === "running") curve.push([state.time_s, state.ttc_s, state.artc_per_s]);
        while (curve.length && curve[0][0] < state.time_s - CURVE_S) curve.shift();
        show(); draw();
        // The next picture comes when this one has been drawn, however slow the browser or the line is.
        requestAnimationFrame(() => requestAnimationFrame(() => send({ kind: "seen", frame: message.frames })));
      }
    };
    socket.onclose = () => {
      if (ended) return;
      const warn = by("wc-warn");
      warn.textContent = "The connection to workcell is lost"; warn.style.display = "block";
      setTimeout(connect, 1000);
    };
  }
  document.addEventListener("DOMContentLoaded", () => { build(); connect(); setInterval(beat, BEAT_MS); });
})();
