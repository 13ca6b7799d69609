// The safety bar: lamps whose ages the page increases, LIGHT OFF, the sound of an alarm.
(() => {
  let lamps = {}, newsAt = null, silenced = '', deskAlarms = '', pageAlarm = null, beep = null, answer = '',
    answeredAt = 0;
  const ANSWER_MS = 60000;
  const element = id => document.getElementById(id);
  const ago = s => (s < 60 ? s.toFixed(0) + ' s' : s < 3600 ? (s / 60).toFixed(0) + ' min' :
    (s / 3600).toFixed(0) + ' h') + ' ago';
  function draw() {
    if (!element('safety')) return;
    const newsAge = newsAt === null ? Infinity : (performance.now() - newsAt) / 1000;
    let oldest = newsAge;
    for (const name of ['laser', 'interlock', 'recording']) {
      const lamp = lamps[name], age = !lamp || lamp.age_s === null ? Infinity : lamp.age_s + newsAge;
      const known = age <= rigDesk.staleS && lamp.kind !== 'unknown', shown = element('lamp-' + name);
      // a state that is too old may be wrong: the last confirmed state with its age is a fact
      const lastAge = lamp && lamp.last_age_s != null ? ', ' + ago(lamp.last_age_s + newsAge) : '';
      const last = lamp && lamp.last ? lamp.last + lastAge : 'unknown';
      const text = name + ' ' + (known ? lamp.text : last) + (lamp && lamp.more ? '; ' + lamp.more : '');
      if (shown.textContent !== text) shown.textContent = text;
      shown.className = 'lamp ' + (known ? lamp.kind : 'unknown');
      if (name !== 'recording' && lamp && lamp.age_s !== null) oldest = Math.max(oldest, age);
    }
    // a slow desk is not dead: LIGHT OFF has a port of its own
    const dead = document.documentElement.classList.contains('dead'), off = element('light-off');
    const label = dead ? 'LIGHT OFF (no connection: key switch)' : 'LIGHT OFF';
    if (off.textContent !== label) off.textContent = label;
    off.classList.toggle('gone', dead);
    const hasLaser = lamps.laser && lamps.laser.age_s !== null;
    element('lamp-age').textContent = dead ? 'not connected' + (newsAt === null ? '' :
      ' for ' + newsAge.toFixed(0) + ' s') : hasLaser ?
      oldest.toFixed(1) + ' s old' : lamps.laser && lamps.laser.last ? '' : 'no news of the laser yet';
    const late = dead || (hasLaser && oldest > rigDesk.staleS);
    element('lamp-age').className = 'lamp ' + (late ? 'unknown' : hasLaser ? 'go' : 'dim');
    element('silence').hidden = !loud() || silenced === loud();
    // an old answer says nothing about the present
    if (performance.now() - answeredAt > ANSWER_MS) answer = '';
    element('off-said').textContent = answer;
    // the page leaves room for the bar
    document.documentElement.style.setProperty('--safety', element('safety').offsetHeight + 'px');
  }
  window.rigSafety = (newLamps, namesOfLoud) => {
    lamps = newLamps; newsAt = performance.now(); deskAlarms = namesOfLoud;
    updateSound();
    draw();
  };
  // an alarm of the page itself replaces the last alarms of the desk
  const loud = () => pageAlarm === null ? deskAlarms : pageAlarm;
  function updateSound() {
    if (loud() !== silenced) silenced = '';
    sound(loud() !== '' && silenced !== loud());
  }
  window.rigCry = alarm => { if (alarm !== pageAlarm) { pageAlarm = alarm; updateSound(); draw(); } };
  window.rigLightOff = () => {
    const pressed = new Date().toLocaleTimeString('en-GB');
    answer = 'LIGHT OFF is sent'; answeredAt = performance.now(); draw();
    const press = '?' + Math.random().toString(36).slice(2) + Date.now();
    const other = location.protocol + '//' + location.hostname + ':' + rigDesk.offPort + rigDesk.dark + press;
    const send = address => fetch(address, {method: 'POST', credentials: 'include', keepalive: true})
      .then(reply => reply.ok ? reply.text() : Promise.reject(new Error(reply.status)));
    Promise.any([send(other), send(rigDesk.dark + press)]).then(
      problems => { answer = 'LIGHT OFF was taken at ' + pressed + (problems ? ', BUT ' + problems : ''); },
      () => { answer = 'LIGHT OFF DID NOT REACH THE DESK: turn the key switch'; }).then(draw);
  };
  function sound(on) {
    if (!on) { clearInterval(beep); beep = window.rigBeep = null; return; }
    if (beep) return;
    const play = () => {
      const context = window.rigAudio || (window.rigAudio = new AudioContext());
      // the browser suspends the sound of a page that was not touched yet
      if (context.state === 'suspended') context.resume();
      const tone = context.createOscillator(), loudness = context.createGain();
      tone.frequency.value = 880; loudness.gain.value = 0.2;
      tone.connect(loudness).connect(context.destination);
      tone.start(); tone.stop(context.currentTime + 0.25);
    };
    play(); beep = window.rigBeep = setInterval(play, 1000);
  }
  document.addEventListener('click', event => {
    const button = event.target.closest('#light-off, #silence');
    if (button && button.id === 'light-off') window.rigLightOff();
    if (button && button.id === 'silence') { silenced = loud(); sound(false); draw(); }
  }, true);
  window.addEventListener('keydown', event => {
    if (event.key === 'F9') { event.preventDefault(); if (!event.repeat) window.rigLightOff(); }
  }, true);
  setInterval(draw, 250);

  // a button that lights, or allows light, takes a pointer, or a key that is held on it: no typing presses it
  const HOLD_MS = 1000;
  let holding = null;
  window.rigPresses = {};
  const deliberateButton = target => target && target.closest && target.closest('[data-deliberate]');
  const release = () => { if (holding) { clearTimeout(holding); holding = null; } };
  for (const name of ['click', 'keydown', 'keyup'])
    window.addEventListener(name, event => {
      const button = deliberateButton(event.target);
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
