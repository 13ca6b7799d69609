"""The safety bar at the foot of every page: lamps with their ages, LIGHT OFF, silence.

It is drawn by the page itself, over dialogs too, so that a desk which says nothing any more is seen: what is
older than two seconds is unknown, never the last value.
"""

from rig.control import STALE_S
from rig.desk.tab import PRESSES
from rig.presentation import palette

DARK = "/dark"
"""Where LIGHT OFF is sent to, at both servers."""

BAR = """
<div id="safety" role="region" aria-label="safety">
  <button id="light-off" type="button" aria-label="light off, key F9">LIGHT OFF</button>
  <span class="lamp" id="lamp-laser" role="status" aria-live="polite"></span>
  <span class="lamp" id="lamp-interlock" role="status" aria-live="polite"></span>
  <span class="lamp" id="lamp-recording"></span>
  <span class="lamp" id="lamp-age"></span>
  <span id="off-said" role="status" aria-live="assertive"></span>
  <button id="silence" type="button" hidden>Silence</button>
</div>
"""

STYLE = f"""
#safety {{ position: fixed; left: 0; right: 0; bottom: 0; z-index: 20000; display: flex; flex-wrap: wrap;
  gap: 4px 14px; align-items: center; padding: 5px 10px; background: var(--bar); color: var(--bar-ink);
  border-top: 2px solid var(--bar-ink); font-size: 16px; }}
#safety button {{ font: inherit; font-weight: 700; padding: 8px 18px; border: 2px solid var(--bar-ink);
  border-radius: 4px; background: var(--bar-button); color: var(--bar-ink); cursor: pointer; }}
#safety #light-off {{ background: var(--off); color: var(--off-ink); font-size: 20px; }}
/* it is tried also then */
#safety #light-off.gone {{ background: var(--bar); color: var(--bar-ink); border-style: dashed;
  font-size: 16px; }}
#safety #silence {{ margin-left: auto; }}
/* a lamp has the colour, its words do not */
#safety .lamp {{ color: var(--bar-ink); font-weight: 400; }}
#safety .lamp::before {{ content: ''; display: inline-block; width: 14px; height: 14px; border-radius: 7px;
  margin-right: 6px; background: var(--edge); }}
#safety .go::before {{ background: {palette.BLUISH_GREEN}; }}
#safety .caution::before {{ background: {palette.YELLOW}; }}
#safety .no::before {{ background: {palette.VERMILLION}; }}
#safety .unknown {{ color: var(--bar-dim); font-style: italic; }}
#safety .unknown::before {{ background: transparent; border: 2px dashed var(--bar-dim);
  box-sizing: border-box; }}
.nicegui-content {{ padding-bottom: 64px; }}
.q-notifications__list--bottom {{ bottom: 64px !important; }}
@media (max-width: 600px) {{ .nicegui-content {{ padding-bottom: 120px; }}
  #safety {{ font-size: 14px; gap: 3px 10px; }} #safety #light-off {{ width: 100%; }}
  .q-notifications__list--bottom {{ bottom: 120px !important; }} }}
"""


def script(off_port: int) -> str:
    """What the bar does; `off_port` is that of the server beside the event loop."""
    of_page = {"OFF_PORT": str(off_port), "STALE_S": f"{STALE_S:g}", "DARK": DARK, "PRESSES": PRESSES}
    told = _SCRIPT
    for name, value in of_page.items():
        told = told.replace(name, value)
    return told


_SCRIPT = """
(() => {
  let told = {}, heard = null, silenced = '', cry = '', own = null, beep = null, answer = '',
    answeredAt = 0;
  const ANSWER_MS = 60000;
  const at = id => document.getElementById(id);
  function draw() {
    if (!at('safety')) return;
    const since = heard === null ? Infinity : (performance.now() - heard) / 1000;
    let oldest = since;
    for (const name of ['laser', 'interlock', 'recording']) {
      const lamp = told[name], old = !lamp || lamp.age_s === null ? Infinity : lamp.age_s + since;
      const known = old <= STALE_S && lamp.kind !== 'unknown', shown = at('lamp-' + name);
      const text = (name === 'recording' ? 'recording ' : name + ' ') + (known ? lamp.text : 'unknown');
      if (shown.textContent !== text) shown.textContent = text;
      shown.className = 'lamp ' + (known ? lamp.kind : 'unknown');
      if (name !== 'recording' && lamp && lamp.age_s !== null) oldest = Math.max(oldest, old);
    }
    const dead = since > STALE_S;
    // just opened it has not been answered yet
    const gone = dead && (heard !== null || performance.now() / 1000 > STALE_S), off = at('light-off');
    const named = gone ? 'LIGHT OFF (no connection: key switch)' : 'LIGHT OFF';
    if (off.textContent !== named) off.textContent = named;
    off.classList.toggle('gone', gone);
    at('lamp-age').textContent = dead ? 'the desk does not answer' + (heard === null ? '' :
      ' for ' + since.toFixed(0) + ' s') : told.laser && told.laser.age_s !== null ?
      oldest.toFixed(1) + ' s old' : 'no news of the laser';
    const heardOf = told.laser && told.laser.age_s !== null;
    const late = dead || (heardOf && oldest > STALE_S);
    at('lamp-age').className = 'lamp ' + (late ? 'unknown' : heardOf ? 'go' : 'dim');
    at('silence').hidden = !loud() || silenced === loud();
    // what was answered long ago says nothing of now
    if (performance.now() - answeredAt > ANSWER_MS) answer = '';
    at('off-said').textContent = answer;
  }
  window.rigSafety = (now, alarm) => {
    told = now; heard = performance.now();
    cry = alarm;
    hear();
    draw();
  };
  // what the page itself has found is heard beside what the desk has told last
  const loud = () => own === null ? cry : own;
  function hear() {
    if (loud() !== silenced) silenced = '';
    sound(loud() !== '' && silenced !== loud());
  }
  window.rigCry = what => { if (what !== own) { own = what; hear(); draw(); } };
  window.rigLightOff = () => {
    const pressed = new Date().toLocaleTimeString('en-GB');
    answer = 'LIGHT OFF is sent'; answeredAt = performance.now(); draw();
    const press = '?' + Math.random().toString(36).slice(2) + Date.now();
    const other = location.protocol + '//' + location.hostname + ':OFF_PORTDARK' + press;
    const ask = address => fetch(address, {method: 'POST', credentials: 'include', keepalive: true})
      .then(got => got.ok ? got.text() : Promise.reject(new Error(got.status)));
    Promise.any([ask(other), ask('DARK' + press)]).then(
      said => { answer = 'LIGHT OFF was taken at ' + pressed + (said ? ', BUT ' + said : ''); },
      () => { answer = 'LIGHT OFF DID NOT REACH THE DESK: turn the key switch'; }).then(draw);
  };
  function sound(on) {
    if (!on) { clearInterval(beep); beep = window.rigBeep = null; return; }
    if (beep) return;
    const cryOut = () => {
      const context = window.rigAudio || (window.rigAudio = new AudioContext());
      // of a page that nobody has touched yet the browser holds the sound back
      if (context.state === 'suspended') context.resume();
      const tone = context.createOscillator(), loudness = context.createGain();
      tone.frequency.value = 880; loudness.gain.value = 0.2;
      tone.connect(loudness).connect(context.destination);
      tone.start(); tone.stop(context.currentTime + 0.25);
    };
    cryOut(); beep = window.rigBeep = setInterval(cryOut, 1000);
  }
  document.addEventListener('click', event => {
    const on = event.target.closest('#light-off, #silence');
    if (on && on.id === 'light-off') window.rigLightOff();
    if (on && on.id === 'silence') { silenced = loud(); sound(false); draw(); }
  }, true);
  window.addEventListener('keydown', event => {
    if (event.key === 'F9') { event.preventDefault(); if (!event.repeat) window.rigLightOff(); }
  }, true);
  setInterval(draw, 250);

  // what lights, or allows light, takes a pointer, or a key that is held on the button: nothing that is typed
  const HOLD_MS = 1000;
  let holding = null;
  window.PRESSES = {};
  const deliberate = target => target && target.closest && target.closest('[data-deliberate]');
  const release = () => { if (holding) { clearTimeout(holding); holding = null; } };
  for (const name of ['click', 'keydown', 'keyup'])
    window.addEventListener(name, event => {
      const button = deliberate(event.target);
      if (!button) return;
      if (name === 'click') {
        if (event.detail > 0 || button.rigHeld) {
          window.PRESSES[button.id] = performance.now();
          return;
        }
      } else if (event.key !== 'Enter' && event.key !== ' ') {
        if (name === 'keydown') release();
        return;
      } else if (name === 'keyup') {
        release();
      } else if (!event.repeat) {
        release();
        holding = setTimeout(() => {
          button.rigHeld = true;
          button.click();
          button.rigHeld = false;
        }, HOLD_MS);
      }
      event.preventDefault(); event.stopImmediatePropagation();
    }, true);
  window.addEventListener('blur', release);
  window.addEventListener('focusout', release, true);
})();
"""
