// Exposure, gain, white balance and focus, as far as a browser has them, in units that all cameras share.
"use strict";
const MOST_DIOPTRES = 100;
const CONTROLS = {
  exposure: {key: "exposureTime", mode: "exposureMode", unit: "µs", told: value => value * 100, kept: value => value / 100},
  gain: {key: "iso", mode: "exposureMode", unit: "×", told: value => value / 100, kept: value => value * 100},
  "white-balance": {key: "colorTemperature", mode: "whiteBalanceMode", unit: "K", told: value => value, kept: value => value},
  focus: {
    key: "focusDistance", mode: "focusMode", unit: "dpt",
    told: value => Math.min(MOST_DIOPTRES, 1 / value), kept: value => 1 / Math.max(value, 1e-3),
  },
};
// Values to set again, because a reopened camera has lost its settings.
const heldControls = {};

function controlStates(track) {
  const can = track && track.getCapabilities ? track.getCapabilities() : {}, now = track ? track.getSettings() : {};
  return Object.entries(CONTROLS).flatMap(([control, {key, mode, unit, told}]) => {
    if (!can[key] || typeof can[key].max !== "number") return [];
    const modes = can[mode] || [], ends = [told(can[key].min), told(can[key].max)].sort((one, other) => one - other);
    const state = {
      control, unit, value: typeof now[key] === "number" ? told(now[key]) : null,
      automatic: now[mode] !== "manual" && modes.includes("continuous"), can_be_automatic: modes.includes("continuous"),
    };
    return [modes.includes("manual") ? {...state, minimum: ends[0], maximum: ends[1]} : state];
  });
}

async function applyHeld(track, released = null) {
  const wanted = released ? {[CONTROLS[released].mode]: "continuous"} : {};
  for (const [control, value] of Object.entries(heldControls)) {
    const {key, mode, kept} = CONTROLS[control];
    wanted[mode] = "manual";
    wanted[key] = kept(value);
  }
  if (Object.keys(wanted).length) await track.applyConstraints({advanced: [wanted]});
}

// Set a control to a fixed value; null lets the camera choose it.
async function setControl(track, control, value) {
  const before = heldControls[control];
  delete heldControls[control];
  if (value !== null) heldControls[control] = value;
  try {
    await applyHeld(track, value === null ? control : null);
  } catch (error) {
    delete heldControls[control];
    if (before !== undefined) heldControls[control] = before;
    throw error;
  }
}
