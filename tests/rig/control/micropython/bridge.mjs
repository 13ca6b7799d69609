// Runs the controller's firmware on the MicroPython interpreter, wired to file descriptors.
//
//   node bridge.mjs PACKAGE FIRMWARE_DIR BOARD_FILE SERIAL_FD CONTROL_FD LOG_FILE
//
// The firmware's own files are loaded unchanged; only board.py is the test board beside this
// file. CONTROL_FD takes single bytes: 'o' opens and 'c' closes the interlock, 'x' and 's' take
// the environment sensor away and give it back, 'r' resets the board (a new interpreter, as after a
// brown-out), 'h' hangs the loop for 700 ms, 'b' opens the interlock for 20 ms, 'u' makes the relay read closed
// whatever it was told, 'f' repairs the relay, 'm' marks the moment in LOG_FILE, 'k' presses and 'K' lets go the button,
// 'l' and 'd' wire a photodiode that sees light or none. Every change of an output is a line in LOG_FILE.
import * as fs from 'node:fs';
import * as path from 'node:path';
import { pathToFileURL } from 'node:url';

const [packageDir, firmwareDir, boardFile, serialFdText, controlFdText, logFile] = process.argv.slice(2);
const serialFd = Number(serialFdText);
const controlFd = Number(controlFdText);
const log = fs.openSync(logFile, 'a');
const { loadMicroPython } = await import(pathToFileURL(path.join(packageDir, 'micropython.mjs')));

const buffer = Buffer.alloc(4096);
const sleeper = new Int32Array(new SharedArrayBuffer(4));
const state = { interlock: true, sensor: true, reset: false, stuck: false, stuckOn: false, mark: false, openTo: 0,
  opened: false, pressed: false, light: -1, latch: '0 NONE' };
let quietTurns = 0;

function take(fd) {
  try {
    return buffer.subarray(0, fs.readSync(fd, buffer, 0, buffer.length, null));
  } catch (error) {
    // EAGAIN: nothing there. EIO: nobody holds the other side of the terminal.
    if (error.code === 'EAGAIN' || error.code === 'EIO') return buffer.subarray(0, 0);
    throw error;
  }
}

function sleep(ms) {
  Atomics.wait(sleeper, 0, 0, ms);
}

const wires = {
  interlock: () => state.interlock && performance.now() >= state.openTo,
  // as the interrupt of the pin, which sees an opening that the loop is too slow for
  opened: () => {
    const opened = state.opened;
    state.opened = false;
    return opened;
  },
  sensor: () => state.sensor,
  stuck: () => state.stuck,
  pressed: () => state.pressed,
  light: () => state.light,
  latch: () => state.latch,
  storeLatch: (text) => { state.latch = text; },
  stuckOn: () => state.stuckOn,
  marked: () => {
    const marked = state.mark;
    state.mark = false;
    return marked;
  },
  log: (line) => fs.writeSync(log, line + '\n'),
  resetWanted: () => state.reset,
  read: () => {
    const data = take(serialFd);
    if (data.length > 0) quietTurns = 0;
    return data.toString('hex');
  },
  write: (hex) => {
    const data = Buffer.from(hex, 'hex');
    let sent = 0;
    while (sent < data.length) {
      try {
        sent += fs.writeSync(serialFd, data, sent);
      } catch (error) {
        if (error.code === 'EIO') return;
        if (error.code !== 'EAGAIN') throw error;
        sleep(1);
      }
    }
  },
  idle: () => {
    if (quietTurns % 8 === 0) {
      for (const byte of take(controlFd)) {
        const key = String.fromCharCode(byte);
        if (key === 'o') state.interlock = false;
        if (key === 'o' || key === 'b') state.opened = true;
        if (key === 'c') state.interlock = true;
        if (key === 'x') state.sensor = false;
        if (key === 's') state.sensor = true;
        if (key === 'r') state.reset = true;
        if (key === 'p') state.stuck = true;
        if (key === 'h') sleep(700);
        if (key === 'b') state.openTo = performance.now() + 20;
        if (key === 'u') state.stuckOn = true;
        if (key === 'f') state.stuck = state.stuckOn = false;
        if (key === 'm') state.mark = true;
        if (key === 'k' || key === 'K') state.pressed = key === 'k';
        if (key === 'l' || key === 'd') state.light = key === 'l' ? 1 : 0;
      }
    }
    quietTurns += 1;
    // Stay awake while the line is busy; an idle board, also between two heartbeats, must not keep a core of the
    // test machine busy.
    if (quietTurns > 100) sleep(5);
    else if (quietTurns > 20) sleep(0.2);
  },
};

for (;;) {
  state.reset = false;
  const mp = await loadMicroPython({ stdout: (line) => process.stderr.write(line + '\n'), linebuffer: true });
  mp.FS.mkdir('/lib');
  for (const name of ['core.py', 'lines.py', 'main.py', 'bme280.py']) {
    mp.FS.writeFile('/lib/' + name, fs.readFileSync(path.join(firmwareDir, name)));
  }
  mp.FS.writeFile('/lib/board.py', fs.readFileSync(boardFile));
  mp.registerJsModule('wires', wires);
  try {
    mp.runPython('import main');
  } catch (error) {
    if (!state.reset) {
      process.stderr.write(String(error) + '\n');
      process.exit(1);
    }
  }
}
