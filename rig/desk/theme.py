"""How the desk looks: dark, readable at arm's length; at night nothing but red light, for adapted eyes."""

from rig.presentation import palette

STYLE = f"""
:root {{ color-scheme: dark; --ink: #e8e8e8; --dim: #9aa4ad; --ground: #0e1113; --card: #181d21;
  --go: {palette.BLUISH_GREEN}; --warn: {palette.ORANGE}; --no: {palette.VERMILLION};
  --line: {palette.SKY_BLUE}; }}
html.night {{ filter: url(#night); }}
body {{ background: var(--ground); color: var(--ink); font-size: 16px; }}
.q-header {{ background: var(--card) !important; min-height: 40px; padding: 2px 12px !important;
  align-items: center !important; }}
.q-page, .q-tab-panels, .q-tab-panel {{ background: var(--ground) !important; color: var(--ink); }}
.q-tab-panel {{ padding: 6px 10px; }}
.nicegui-content {{ padding: 0; gap: 4px; }} .box {{ gap: 6px; }} .q-tab-panel > * {{ gap: 8px; }}
.q-tab-panel {{ gap: 8px; }}
.box {{ background: var(--card); border-radius: 6px; padding: 10px 12px; }}
.title {{ color: var(--dim); font-size: 13px; letter-spacing: .06em; text-transform: uppercase; }}
.large {{ font-size: 76px; line-height: 1; font-variant-numeric: tabular-nums; font-weight: 600; }}
.middle {{ font-size: 30px; line-height: 1.2; font-variant-numeric: tabular-nums; }}
.two, .three {{ display: grid; gap: 8px; width: 100%; grid-template-columns: minmax(0, 2fr) minmax(0, 1fr); }}
.three {{ grid-template-columns: minmax(0, 1.25fr) minmax(0, 1fr) minmax(0, 1fr); }}
.two.half {{ grid-template-columns: repeat(2, minmax(0, 1fr)); }}
.three.even {{ grid-template-columns: repeat(3, minmax(0, 1fr)); }}
@media (max-width: 900px) {{
  .two, .three, .two.half, .three.even {{ grid-template-columns: minmax(0, 1fr); }} }}
.cries {{ position: sticky; top: 40px; z-index: 1000; width: 100%; }}
.why-none {{ font-size: 20px; text-align: center; width: 80%; }}
.rows {{ border-collapse: collapse; width: 100%; font-size: 14px; line-height: 1.3;
  font-variant-numeric: tabular-nums; }}
.rows td, .rows th {{ padding: 2px 8px 2px 0; vertical-align: top; text-align: left; font-weight: 400; }}
.rows .judged {{ white-space: nowrap; width: 1%; }}
.rows th {{ color: var(--dim); white-space: nowrap; }}
.dim {{ color: var(--dim); }} .go {{ color: var(--go); }} .caution {{ color: var(--warn); }}
.no {{ color: var(--no); font-weight: 700; }}
.light {{ display: inline-block; width: 12px; height: 12px; border-radius: 6px; margin-right: 6px; }}
.alarm {{ background: {palette.VERMILLION}; color: #000; font-size: 26px; font-weight: 700; padding: 8px 14px;
  animation: flash 1s steps(2, jump-none) infinite; width: 100%; }}
.instruction {{ background: {palette.YELLOW}; color: #000; font-size: 30px; font-weight: 700;
  padding: 8px 14px; width: 100%; }}
@keyframes flash {{ from {{ opacity: 1 }} to {{ opacity: .55 }} }}
@media (prefers-reduced-motion: reduce) {{ .alarm {{ animation: none; }} }}
.events {{ font-size: 14px; max-height: 190px; overflow-y: auto; width: 100%; }}
svg text {{ fill: var(--dim); font-size: 12px; }}
.text-negative, .q-field--error .q-field__messages {{ color: #ff8a65 !important; }}
.picture {{ background: #000; }} .picture img {{ image-rendering: pixelated; touch-action: none; }}
:focus-visible {{ outline: 2px solid var(--line); outline-offset: 2px; }}
"""

NIGHT = """
<svg width="0" height="0" style="position: absolute" aria-hidden="true"><filter id="night"
  color-interpolation-filters="sRGB"><feColorMatrix values=".55 .55 .3 0 0  0 0 0 0 0  0 0 0 0 0  0 0 0 1 0"/>
</filter></svg>
"""
"""Turns the brightness of everything on the page into red, the pictures of the camera included."""

SCRIPT = """
window.rigNight = function (on) {
  document.documentElement.classList.toggle('night', on);
  localStorage.setItem('night', on ? '1' : '');
};
window.rigNight(localStorage.getItem('night') === '1');
window.rigAlarm = function (on) {
  if (!on) { clearInterval(window.rigBeep); window.rigBeep = null; return; }
  if (window.rigBeep) return;
  const beep = function () {
    const context = window.rigAudio || (window.rigAudio = new AudioContext());
    // of a page that nobody has touched yet the browser holds the sound back
    if (context.state === 'suspended') context.resume();
    const tone = context.createOscillator(), loudness = context.createGain();
    tone.frequency.value = 880; loudness.gain.value = 0.2;
    tone.connect(loudness).connect(context.destination);
    tone.start(); tone.stop(context.currentTime + 0.25);
  };
  beep(); window.rigBeep = setInterval(beep, 1000);
};
"""
