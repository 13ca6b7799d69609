"""How the desk looks: dark, readable at arm's length; red on black at night, for adapted eyes."""

from rig.presentation import palette

STYLE = f"""
:root {{ color-scheme: dark; --ink: #e8e8e8; --dim: #9aa4ad; --ground: #0e1113; --card: #181d21;
  --go: {palette.BLUISH_GREEN}; --warn: {palette.ORANGE}; --no: {palette.VERMILLION};
  --line: {palette.SKY_BLUE}; }}
body.night {{ --ink: #ff5040; --dim: #a02818; --ground: #000000; --card: #120000; --go: #a03020;
  --warn: #d04030; --no: #ff5040; --line: #d03828; }}
body.night img, body.night .picture {{ filter: grayscale(1) sepia(1) saturate(8) hue-rotate(-50deg); }}
body.night .q-btn, body.night .q-tab, body.night .q-field__native, body.night .q-field__label
  {{ color: var(--ink) !important; }}
body.night .bg-primary, body.night .q-header {{ background: var(--card) !important; }}
body {{ background: var(--ground); color: var(--ink); font-size: 16px; }}
.q-header {{ background: var(--card) !important; }}
.q-page, .q-tab-panels, .q-tab-panel {{ background: var(--ground) !important; color: var(--ink); }}
.q-tab-panel {{ padding: 6px 10px; }}
.nicegui-content {{ padding: 0; gap: 4px; }} .box {{ gap: 6px; }} .q-tab-panel > * {{ gap: 8px; }}
.q-tab-panel {{ gap: 8px; }}
.box {{ background: var(--card); border-radius: 6px; padding: 10px 12px; }}
.title {{ color: var(--dim); font-size: 13px; letter-spacing: .06em; text-transform: uppercase; }}
.large {{ font-size: 76px; line-height: 1; font-variant-numeric: tabular-nums; font-weight: 600; }}
.middle {{ font-size: 30px; line-height: 1.2; font-variant-numeric: tabular-nums; }}
.rows {{ border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }}
.rows td, .rows th {{ padding: 2px 8px 2px 0; vertical-align: top; text-align: left; font-weight: 400; }}
.rows th {{ color: var(--dim); white-space: nowrap; }}
.dim {{ color: var(--dim); }} .go {{ color: var(--go); }} .caution {{ color: var(--warn); }}
.no {{ color: var(--no); font-weight: 700; }}
.light {{ display: inline-block; width: 14px; height: 14px; border-radius: 7px; margin-right: 6px; }}
.alarm {{ background: {palette.VERMILLION}; color: #000; font-size: 26px; font-weight: 700; padding: 8px 14px;
  animation: flash 1s steps(2, jump-none) infinite; width: 100%; }}
.instruction {{ background: {palette.YELLOW}; color: #000; font-size: 30px; font-weight: 700;
  padding: 8px 14px; width: 100%; }}
@keyframes flash {{ from {{ opacity: 1 }} to {{ opacity: .55 }} }}
@media (prefers-reduced-motion: reduce) {{ .alarm {{ animation: none; }} }}
.events {{ font-size: 14px; max-height: 190px; overflow-y: auto; width: 100%; }}
svg text {{ fill: var(--dim); font-size: 12px; }}
.text-negative, .q-field--error .q-field__messages {{ color: #ff8a65 !important; }}
.picture img {{ image-rendering: pixelated; }}
:focus-visible {{ outline: 2px solid var(--line); outline-offset: 2px; }}
"""

SOUND = """
window.rigAlarm = function (on) {
  if (!on) { clearInterval(window.rigBeep); window.rigBeep = null; return; }
  if (window.rigBeep) return;
  const beep = function () {
    const context = window.rigAudio || (window.rigAudio = new AudioContext());
    const tone = context.createOscillator(), loudness = context.createGain();
    tone.frequency.value = 880; loudness.gain.value = 0.2;
    tone.connect(loudness).connect(context.destination);
    tone.start(); tone.stop(context.currentTime + 0.25);
  };
  beep(); window.rigBeep = setInterval(beep, 1000);
};
"""
