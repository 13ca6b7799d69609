// The safety bar: lamps that grow older by themselves, LIGHT OFF, the sound of an alarm.
(() => {
  let told = {}, heard = null, silenced = '', cry = '', own = null, beep = null, answer = '',
    answeredAt = 0;
  const ANSWER_MS = 60000;
  const at = id => document.getElementById(id);
  const ago = s => (s < 60 ? s.toFixed(0) + ' s' : s < 3600 ? (s / 60).toFixed(0) + ' min' :
    (s / 3600).toFixed(0) + ' h') + ' ago';
  function draw() {
    if (!at('safety')) return;
    const since = heard === null ? Infinity : (performance.now() - heard) / 1000;
    let oldest = since;
    for (const name of ['laser', 'interlock', 'recording']) {
      const lamp = told[name], old = !lamp || lamp.age_s === null ? Infinity : lamp.age_s + since;
      const known = old <= rigDesk.staleS && lamp.kind !== 'unknown', shown = at('lamp-' + name);
      // what is too old is no state: what was confirmed last is a fact, with its age
      const age = lamp && lamp.last_age_s != null ? ', ' + ago(lamp.last_age_s + since) : '';
      const last = lamp && lamp.last ? lamp.last + age : 'unknown';
      const text = name + ' ' + (known ? lamp.text : last) + (lamp && lamp.more ? '; ' + lamp.more : '');
      if (shown.textContent !== text) shown.textContent = text;
      shown.className = 'lamp ' + (known ? lamp.kind : 'unknown');
      if (name !== 'recording' && lamp && lamp.age_s !== null) oldest = Math.max(oldest, old);
    }
    // slow is not gone: LIGHT OFF has a port of its own
    const gone = document.documentElement.classList.contains('dead'), off = at('light-off');
    const named = gone ? 'LIGHT OFF (no connection: key switch)' : 'LIGHT OFF';
    if (off.textContent !== named) off.textContent = named;
    off.classList.toggle('gone', gone);
    at('lamp-age').textContent = gone ? 'not connected' + (heard === null ? '' :
      ' for ' + since.toFixed(0) + ' s') : told.laser && told.laser.age_s !== null ?
      oldest.toFixed(1) + ' s old' : told.laser && told.laser.last ? '' : 'no news of the laser yet';
    const heardOf = told.laser && told.laser.age_s !== null;
    const late = gone || (heardOf && oldest > rigDesk.staleS);
    at('lamp-age').className = 'lamp ' + (late ? 'unknown' : heardOf ? 'go' : 'dim');
    at('silence').hidden = !loud() || silenced === loud();
    // what was answered long ago says nothing of now
    if (performance.now() - answeredAt > ANSWER_MS) answer = '';
    at('off-said').textContent = answer;
    // nothing may end below it
    document.documentElement.style.setProperty('--safety', at('safety').offsetHeight + 'px');
  }
  window.rigSafety = (now, crying) => {
    told = now; heard = performance.now();
    cry = crying.map(one => one.name).join(' ');
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
    const other = location.protocol + '//' + location.hostname + ':' + rigDesk.offPort + rigDesk.dark + press;
    const ask = address => fetch(address, {method: 'POST', credentials: 'include', keepalive: true})
      .then(got => got.ok ? got.text() : Promise.reject(new Error(got.status)));
    Promise.any([ask(other), ask(rigDesk.dark + press)]).then(
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
  window.rigPresses = {};
  const deliberate = target => target && target.closest && target.closest('[data-deliberate]');
  const release = () => { if (holding) { clearTimeout(holding); holding = null; } };
  for (const name of ['click', 'keydown', 'keyup'])
    window.addEventListener(name, event => {
      const button = deliberate(event.target);
      if (!button) return;
      if (name === 'click') {
        if (event.detail > 0 || button.rigHeld) {
          window.rigPresses[button.id] = performance.now();
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
