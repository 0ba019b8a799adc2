// Opens the run in rerun's viewer, and reloads when the process behind the page is another one.
"use strict";

const POLL_MS = 2000;
const ANSWER_MS = 5000;
const GONE_AFTER_POLLS = 3;
const LAST_STATE = "What you see is its last state; the page reloads when it is back.";

const element = (id) => document.getElementById(id);
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

function say(text) {
  element("message").textContent = text;
}

function note(text) {
  element("note-text").textContent = text;
  element("note").hidden = text === "";
}

// What the server says of the run; null if it does not answer.
async function ask() {
  try {
    const answer = await fetch("run", { cache: "no-store", signal: AbortSignal.timeout(ANSWER_MS) });
    return answer.ok ? await answer.json() : null;
  } catch {
    return null;
  }
}

// The viewer's debugging is tens of thousands of lines at its start, and seconds of work.
console.debug = () => {};

// The server's word once the viewer's files are there.
async function ready() {
  for (;;) {
    const told = await ask();
    if (told === null) {
      say("Waiting for the dashboard to answer.");
    } else if (told.error) {
      say(`There is no picture: ${told.error}.`);
    } else if (told.viewer) {
      return told;
    } else {
      say("The viewer's files are being made ready; this takes some seconds, once per version.");
    }
    await pause(POLL_MS / 4);
  }
}

// The viewer does not try again by itself, so it is started when its stream can be had.
async function reachable(probe) {
  for (;;) {
    try {
      await fetch(probe, { mode: "no-cors", cache: "no-store", signal: AbortSignal.timeout(ANSWER_MS) });
      return;
    } catch {
      const port = new URL(probe).port;
      say(
        `The page is here, but its stream at port ${port} cannot be reached from this browser.\n` +
          `Publish or tunnel port ${port} as well; it goes on by itself.`,
      );
    }
    await pause(POLL_MS);
  }
}

function load_script(path) {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = path;
    script.onload = resolve;
    script.onerror = () => reject(new Error(`cannot load ${path}`));
    document.head.append(script);
  });
}

// The response with its progress shown; `raw_bytes` is its size without compression.
function counted(response, raw_bytes) {
  let loaded = 0;
  const counter = new TransformStream({
    transform(part, stream) {
      loaded += part.byteLength;
      say(`Loading the viewer: ${Math.min(100, Math.round((100 * loaded) / raw_bytes))} %`);
      stream.enqueue(part);
    },
  });
  const headers = { "Content-Type": "application/wasm" };
  return new Response(response.body.pipeThrough(counter), { status: response.status, headers });
}

async function show(told) {
  await load_script(`${told.viewer}re_viewer.js`);
  const response = await fetch(`${told.viewer}re_viewer_bg.wasm`);
  if (!response.ok) throw new Error(`the viewer's program: status ${response.status}`);
  await wasm_bindgen({ module_or_path: counted(response, told.wasm_bytes) });
  const handle = new wasm_bindgen.WebHandle({
    url: told.sources.map((source) => new URL(source, location.href).href),
    render_backend: new URLSearchParams(location.search).get("renderer"),
    theme: "dark",
    hide_welcome_screen: true,
    persist: false,
    enable_history: false,
  });
  say("Starting the viewer");
  await handle.start(element("viewer"));
  say("");
  element("viewer").hidden = false;
  while (!handle.has_panicked()) await pause(1000);
  throw new Error(handle.panic_message());
}

// Reloads when the process is another one, or is back after it could not be reached.
async function watch(told) {
  let missed = 0;
  for (;;) {
    await pause(POLL_MS);
    const now = await ask();
    if (now === null) {
      missed += 1;
      if (missed === GONE_AFTER_POLLS) {
        note(`${told.probe ? "The dashboard" : "The replay"} has gone. ${LAST_STATE}`);
      }
    } else if (now.life !== told.life || missed >= GONE_AFTER_POLLS) {
      location.reload();
      return;
    } else {
      missed = 0;
    }
  }
}

async function main() {
  element("note-close").addEventListener("click", () => note(""));
  const told = await ready();
  watch(told);
  if (told.probe) await reachable(told.probe);
  try {
    await show(told);
  } catch (error) {
    element("viewer").hidden = true;
    say(
      `The viewer has stopped: ${error.message ?? error}\nReload the page to try again, or open it with ` +
        "?renderer=webgl at the end of its address.",
    );
  }
}

main();
