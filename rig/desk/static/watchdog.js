// What the page finds by itself, without any server: a desk or a session that says nothing.
// Slow comes before dead: a desk whose page is late may still hear LIGHT OFF on its other port.
window.rigJudge = ({since, answers, session}, {staleS, deadS}) => {
  // since: s since the page was told anything; answers: whether the other port does, null before it has said
  const late = since > staleS;
  if (late && (answers === false || since > deadS)) return {state: 'dead', behindS: since};
  if (late) return {state: 'slow', behindS: since};
  const behindS = session === null ? 0 : session.age_s + since;
  return behindS > staleS ? {state: 'behind', behindS} : {state: 'live', behindS: 0};
};
(() => {
  const ASK_MS = 1000, ASK_WITHIN_MS = 1500;
  let heard = null, heardAt = null, session = null, told = new Set(), answers = null, askedAt = -Infinity;
  const clock = at => at.toLocaleTimeString('en-GB');
  const seconds = s => s.toFixed(0) + ' s';
  function ask() {
    const now = performance.now();
    if (now - askedAt < ASK_MS) return;
    askedAt = now;
    const other = location.protocol + '//' + location.hostname + ':' + rigDesk.offPort;
    // whatever it answers, it lives
    fetch(other, {mode: 'no-cors', signal: AbortSignal.timeout(ASK_WITHIN_MS)})
      .then(() => { answers = true; }, () => { answers = false; });
  }
  function words({state, behindS}) {
    const lost = rigDesk.lost;
    if (state === 'dead')
      return ['Not connected: ' + lost.title + (heardAt === null ? ' since this page was opened' :
        ' (last heard at ' + clock(heardAt) + '); what is shown is from then'), lost.remedy];
    if (state === 'slow') return ['The desk is slow: what is shown is ' + seconds(behindS) + ' behind', ''];
    if (state === 'behind')
      return [session.who + ' does not answer: what is shown of it is ' + seconds(behindS) + ' behind', ''];
    return ['', ''];
  }
  function look() {
    const bar = document.getElementById('watchdog');
    if (!bar) return;
    const now = performance.now(), since = (now - (heard === null ? 0 : heard)) / 1000;
    if (since > rigDesk.staleS) ask(); else answers = null;
    const found = rigJudge({since, answers, session}, rigDesk), dead = found.state === 'dead';
    document.documentElement.classList.toggle('dead', dead);
    document.documentElement.classList.toggle('old', found.state === 'behind');
    const [head, remedy] = words(found), shown = head + remedy;
    if (bar.dataset.shown !== shown) {
      const first = bar.dataset.state !== found.state;
      bar.dataset.shown = shown;
      bar.dataset.state = found.state;
      bar.replaceChildren(document.createTextNode(head));
      const small = document.createElement('small');
      small.textContent = remedy;
      bar.append(small);
      bar.hidden = !shown;
      if (dead && first) notify('desk lost', head, remedy);
    }
    if (window.rigCry) window.rigCry(dead ? 'desk lost' : null);
  }
  function notify(tag, title, body) {
    if (!('Notification' in window) || Notification.permission !== 'granted') return;
    try {
      const shown = new Notification(title, {body: body, tag: tag, requireInteraction: true});
      window.rigNotified = (window.rigNotified || []).concat([title]);
      shown.onclick = () => window.focus();
    } catch (error) { console.log('no notification: ' + error); }
  }
  window.rigAlarms = (crying, now) => {
    heard = performance.now(); heardAt = new Date(); session = now;
    const named = new Set(crying.map(one => one.name));
    for (const one of crying) if (!told.has(one.name)) notify(one.title, one.title, one.text);
    told = named;
    look();
  };
  // a browser asks only when a person has pressed something
  document.addEventListener('click', () => {
    if ('Notification' in window && Notification.permission === 'default') Notification.requestPermission();
  }, {once: true, capture: true});
  setInterval(look, 250);
})();
