// Images, curves and sliders of the page; one WebSocket that asks only for what is on the screen.
'use strict';
(() => {
  const WINDOW = 30; // seconds of curves
  const STALE = 3000; // ms without an image
  const seen = new Set(); // canvases on the screen
  const drawnAt = new Map();
  const LENGTH = 25; // m, of the camera's view in space
  let socket = null, asked = '', retry = 500, series = '', curves = new Map(), marks = [], bodies = [], receivedAt = 0;

  const panel = () => document.querySelector('.panel');
  const paused = () => !!document.querySelector('[data-paused=true]');
  const drawn = (holder) => holder && window.getElement && getElement(Number(holder.id.slice(1)));

  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) entry.isIntersecting ? seen.add(entry.target) : seen.delete(entry.target);
    ask();
  });

  function wanted() {
    if (document.hidden) return { images: [], series: '' };
    const keys = [...seen].filter((c) => c.isConnected).map((c) => c.dataset.key);
    return { images: [...new Set(keys)].sort(), series: panel().dataset.node || '' };
  }

  // Nothing of one node stays under the name of another.
  function begin(name) {
    if (name === series) return;
    series = name; curves = new Map(); marks = []; receivedAt = performance.now();
    document.querySelector('.figures')?.replaceChildren();
    trust('stale', 'no results yet');
    for (const body of bodies) drawn(document.querySelector('.scene'))?.visible(body, false);
    bodies = []; place(null);
    const canvas = document.querySelector('.preview canvas');
    if (canvas) { canvas.width = canvas.width; canvas.parentElement.dataset.fresh = 'never'; drawnAt.delete(canvas); }
  }

  function ask(again) {
    begin(panel()?.dataset.node || '');
    if (!socket || socket.readyState !== WebSocket.OPEN || !panel()) return;
    const text = JSON.stringify(wanted());
    if (text !== asked || again) socket.send(text);
    asked = text;
  }

  function connect() {
    socket = new WebSocket((location.protocol === 'https:' ? 'wss://' : 'ws://') + location.host + '/live');
    socket.binaryType = 'arraybuffer';
    socket.onopen = () => { retry = 500; asked = ''; ask(); };
    socket.onclose = () => { socket = null; setTimeout(connect, retry); retry = Math.min(retry * 2, 5000); };
    socket.onmessage = (event) => typeof event.data === 'string' ? receive(JSON.parse(event.data)) : show(event.data);
  }

  async function show(data) {
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    try {
      const image = await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)], { type: 'image/jpeg' }));
      for (const canvas of paused() ? [] : document.querySelectorAll('canvas.image')) {
        if (canvas.dataset.key === header.key) draw(canvas, image, header);
      }
      image.close();
    } finally {
      if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ drawn: header.key }));
    }
  }

  function draw(canvas, image, header) {
    if (canvas.width !== image.width) canvas.width = image.width;
    if (canvas.height !== image.height) canvas.height = image.height;
    canvas.fullSize = [header.width, header.height];
    canvas.number = header.number;
    const context = canvas.getContext('2d');
    context.drawImage(image, 0, 0);
    const rows = (canvas.dataset.rows || '').split(',').filter(Boolean).map(Number);
    if (rows.length === 2 && rows[1] > rows[0]) {
      context.setLineDash([8, 5]); context.lineWidth = 1.5; context.strokeStyle = '#ffb000';
      for (const row of rows) {
        const y = (row * canvas.height) / header.height;
        context.beginPath(); context.moveTo(0, y); context.lineTo(canvas.width, y); context.stroke();
      }
    }
    const words = canvas.closest('.tile')?.querySelector('.rate');
    if (words && words.textContent !== header.words) words.textContent = header.words;
    canvas.dataset.frames = Number(canvas.dataset.frames || 0) + 1;
    canvas.parentElement.dataset.fresh = 'true';
    drawnAt.set(canvas, performance.now());
  }

  // The pixel of the original under the pointer; the canvas is letterboxed into its box.
  function pixel(canvas, event) {
    if (!canvas.fullSize) return null;
    const box = canvas.getBoundingClientRect();
    const scale = Math.min(box.width / canvas.width, box.height / canvas.height);
    const x = (event.clientX - box.left - (box.width - canvas.width * scale) / 2) / (canvas.width * scale);
    const y = (event.clientY - box.top - (box.height - canvas.height * scale) / 2) / (canvas.height * scale);
    if (x < 0 || y < 0 || x >= 1 || y >= 1) return null;
    return { x: Math.floor(x * canvas.fullSize[0]), y: Math.floor(y * canvas.fullSize[1]) };
  }

  // What is held on the screen is what a click reads and the camera button saves.
  function hold() {
    const held = paused();
    for (const canvas of document.querySelectorAll('.tile canvas.image')) {
      canvas.dispatchEvent(new CustomEvent('held', { detail: { held, number: canvas.number ?? -1 } }));
    }
  }

  document.addEventListener('click', (event) => {
    const canvas = event.target.closest && event.target.closest('canvas.clickable');
    const at = canvas && pixel(canvas, event);
    if (at) canvas.dispatchEvent(new CustomEvent('pixel', { detail: at }));
    // After a click of the pointer the keys are the panel's, not the button's or the tab's.
    if (event.detail && document.activeElement.closest('button, .q-tab')) document.activeElement.blur();
  });

  function receive(message) {
    if (message.series !== series) return;
    receivedAt = performance.now();
    marks.push(...message.marks);
    const touched = new Set();
    for (const [time, chart, values] of message.points) {
      if (!curves.has(chart)) curves.set(chart, new Map());
      const here = curves.get(chart);
      touched.add(chart);
      for (const name of new Set([...here.keys(), ...Object.keys(values)])) {
        if (!here.has(name)) here.set(name, []);
        const line = here.get(name);
        line.push([time, values[name] ?? null]);
        while (line.length && line[0][0] < time - WINDOW) line.shift();
        if (line.every(([, value]) => value === null) && !(name in values)) here.delete(name);
      }
    }
    if (paused()) return;
    read(message);
    place(message.pose, message.view);
    for (const chart of touched) plot(chart);
  }

  function plot(chart) {
    const instance = drawn(document.querySelector(`[data-curves="${chart}"][data-node="${CSS.escape(series)}"]`))?.chart;
    if (!instance) return;
    const lines = [...curves.get(chart)];
    const end = Math.max(...lines.map(([, line]) => line[line.length - 1][0]));
    while (marks.length && marks[0][0] < end - WINDOW) marks.shift();
    const markLine = { silent: true, symbol: 'none', animation: false, lineStyle: { color: '#c77b00' },
      label: { formatter: '{b}', fontSize: 10, color: '#c77b00', position: 'insideEndTop' },
      data: marks.map(([time, name]) => ({ xAxis: +(time - end).toFixed(3), name })) };
    instance.setOption({
      legend: { data: lines.map(([name]) => name) },
      series: lines.map(([name, line], number) => ({
        id: name, name, type: 'line', showSymbol: false, animation: false, lineStyle: { width: 1.4 },
        data: line.map(([time, value]) => [+(time - end).toFixed(3), value]),
        ...(number ? {} : { markLine }),
      })),
    }, { lazyUpdate: true, replaceMerge: ['series'] });
  }

  // Figures and how far to trust them; as text only.
  function read(message) {
    trust(...message.trust);
    const holder = document.querySelector('.figures');
    if (!holder) return;
    while (holder.children.length > message.figures.length) holder.lastChild.remove();
    message.figures.forEach((words, number) => {
      const box = holder.children[number] || holder.appendChild(document.createElement('div'));
      if (!box.firstChild) box.append(...['dt', 'dd', 'dd'].map((tag) => document.createElement(tag)));
      words.forEach((text, place) => { if (box.children[place].textContent !== text) box.children[place].textContent = text; });
    });
  }
  function trust(state, words) {
    const label = document.querySelector('.trust');
    if (!label || (label.dataset.trust === state && label.textContent === words)) return;
    label.dataset.trust = state; label.textContent = words;
  }

  // The bodies in space: one moves, another may stand at the origin.
  function place(pose, view) {
    const holder = document.querySelector('.scene'), scene = drawn(holder);
    if (!scene?.renderer || !holder.dataset.objects) return;
    holder.closest('.pose').dataset.known = String(!!pose);
    const [moved, still, cone] = holder.dataset.objects.split(' ');
    bodies = [moved, still];
    scene.visible(moved, !!pose);
    if (view) scene.scale(cone, LENGTH, LENGTH * view[0], LENGTH * view[1]);
    scene.visible(still, true); scene.move(still, 0, 0, 0);
    scene.rotate(still, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    if (pose) { scene.move(moved, ...pose[0]); scene.rotate(moved, pose[1]); }
  }

  // A slider speaks its value with the unit, and follows the server once that has answered the hand at it.
  let held = null, movedAt = 0, heldUntil = 0;
  function speak(slider) {
    const value = (slider.dataset.values || '').split(' ')[slider.value];
    if (value === undefined) return;
    const words = `${value} ${slider.dataset.unit || ''}`.trim();
    if (slider.getAttribute('aria-valuetext') !== words) slider.setAttribute('aria-valuetext', words);
  }
  function follow(slider) {
    if (slider === held && performance.now() < heldUntil) return;
    if (slider.value !== slider.dataset.index) slider.value = slider.dataset.index;
    speak(slider);
  }
  function followAll() { for (const slider of document.querySelectorAll('input.range')) follow(slider); }
  document.addEventListener('input', (event) => {
    if (!event.target.matches('input.range')) return;
    held = event.target; movedAt = performance.now(); heldUntil = movedAt + 5000;
    speak(held);
  });

  // What was entered as the link broke may not have arrived: it is sent again, in order, when the link is back.
  let unanswered = null;
  function resend(link) {
    if (!link || unanswered) return;
    unanswered = new Set();
    const emit = link.emit.bind(link);
    const send = (message) => emit('event', message, () => unanswered.delete(message));
    link.emit = (name, message, ...more) => {
      const entered = name === 'event' && document.getElementById(`c${message.id}`)?.closest('.q-field, .q-toggle, .range');
      if (name !== 'event' || (link.connected && !entered)) return emit(name, message, ...more);
      unanswered.add(message);
      return link.connected ? send(message) : link;
    };
    link.on('connect', () => unanswered.forEach(send));
  }

  function look() {
    resend(window.socket);
    for (const canvas of document.querySelectorAll('canvas.image')) watcher.observe(canvas);
    for (const canvas of [...seen]) if (!canvas.isConnected) { watcher.unobserve(canvas); seen.delete(canvas); }
    const now = performance.now();
    for (const [canvas, time] of drawnAt) {
      if (!canvas.isConnected) drawnAt.delete(canvas);
      else if (now - time > STALE && !paused()) {
        canvas.parentElement.dataset.fresh = 'false';
        const words = canvas.closest('.tile')?.querySelector('.rate');
        if (words) words.textContent = '';
      }
    }
    if (paused()) trust('stale', 'paused');
    else if (now - receivedAt > STALE) trust('stale', `no results for ${Math.round((now - receivedAt) / 1000)} s`);
    followAll();
    ask(true);
  }

  // On a wide screen the parameters stand beside the other parts and are none of the tabs.
  const wide = matchMedia('(min-width: 1000px)');
  let beside = 'images';
  function spread() {
    const part = panel()?.dataset.part || beside;
    if (part !== 'parameters') beside = part;
    else if (wide.matches) document.querySelector(`.tab.${beside}`)?.click();
  }
  wide.addEventListener('change', spread);

  // Neither the browser's own search and undo nor a page that scrolls.
  document.addEventListener('keydown', (event) => {
    const slider = event.target.matches('input.range'), control = event.ctrlKey || event.metaKey;
    const typeless = slider || (control && event.target.matches('[role=combobox][aria-expanded=false]'));
    if (!typeless && /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName)) return;
    if ((control ? 'zZyY' : '/ ').includes(event.key)) event.preventDefault();
    // Keys of the panel are none of a slider's or a menu's, but who types into an input is left alone.
    if (typeless && (control ? 'zZyY' : '1234?/ ').includes(event.key)) event.target.blur();
  });

  document.addEventListener('visibilitychange', () => { ask(); });
  document.addEventListener('DOMContentLoaded', () => {
    connect();
    setInterval(() => { look(); spread(); }, 1000);
    new MutationObserver((changes) => {
      // A new slider stands in its middle until it follows, and a key would move it from there.
      if (changes.some(({ addedNodes }) => [...addedNodes].some((each) => each.nodeType === 1))) followAll();
      for (const { attributeName: name, target } of changes) {
        if (name === 'data-index' && target === held) heldUntil = movedAt + 600;
        if (name === 'data-paused') hold();
        else if (name === 'data-node') ask();
        else if (name === 'data-part') spread();
        else if (name) follow(target);
      }
    }).observe(document.body, {
      subtree: true, childList: true, attributes: true, attributeFilter: ['data-index', 'data-values', 'data-paused', 'data-node', 'data-part'],
    });
  });
})();
