// Browser requirements, with messages for users. Old syntax on purpose, so that old browsers can parse it.
(function () {
  "use strict";
  var lacks = [];
  function need(has, words) { if (!has) lacks.push(words); }
  var canvas = typeof OffscreenCanvas !== "undefined";
  var video = typeof HTMLVideoElement !== "undefined" ? HTMLVideoElement.prototype : {};
  need(window.isSecureContext,
    "A secure connection. Open the address that begins with https://, as the QR code has it.");
  if (window.isSecureContext) {
    need(navigator.mediaDevices && navigator.mediaDevices.getUserMedia,
      "Access to the camera. Browsers inside other apps do not have it: open this page in Chrome, Firefox or Safari itself.");
  }
  need(typeof WebSocket !== "undefined" && typeof Worker !== "undefined" && typeof fetch !== "undefined",
    "WebSockets and workers: the browser is older than 2017.");
  need(canvas && OffscreenCanvas.prototype.convertToBlob && typeof createImageBitmap !== "undefined",
    "Pictures made in the background (OffscreenCanvas): Chrome 69, Firefox 105 or Safari 16.4 and later.");
  need(typeof MediaStreamTrackProcessor !== "undefined" || video.requestVideoFrameCallback,
    "The time of each video frame: Chrome 83, Firefox 132 or Safari 15.4 and later.");
  function element(id) { return document.getElementById(id); }
  if (lacks.length) {
    document.body.className = "bad";
    element("state").textContent = "Cannot join";
    element("words").textContent = "This browser cannot be a camera here. It lacks:";
    for (var i = 0; i < lacks.length; i++) {
      var item = document.createElement("li");
      item.textContent = lacks[i];
      element("lacks").appendChild(item);
    }
    return;
  }
  function load(name) {
    var script = document.createElement("script");
    script.src = name;
    // Run the scripts in the order in which they are added.
    script.async = false;
    script.onerror = function () {
      document.body.className = "bad";
      element("state").textContent = "Cannot join";
      element("words").textContent = "The rest of this page did not come: is the leader still there? Load it again.";
    };
    document.body.appendChild(script);
  }
  load("controls.js");
  load("opening.js");
  load("page.js");
})();
