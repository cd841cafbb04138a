// Runs before viser, in the page that bridge/view/server.py serves: shows a lost connection, and replaces WebGL where
// the browser has no GPU. Without WebGL viser would show neither scene nor controls; WebGL in software takes the
// processor from a robot that is simulated on the same machine ("&3d=1" at the end of the link asks for it).
(() => {
  const add = (tag, style) => Object.assign(document.body.appendChild(document.createElement(tag)), { style });

  // Connection: the server answers /alive, or says why it refuses.
  const watch = () => {
    const note = add("div", "position:fixed;left:1em;bottom:4em;padding:.6em 1em;background:#c92a2a;color:#fff;" +
      "font:16px sans-serif;z-index:9999;display:none");
    note.id = "poise-connection";
    setInterval(async () => {
      const answer = await fetch("/alive").catch(() => null);
      note.textContent = answer === null ? "No connection to 'poise view': start it with 'make view' and open its link."
        : answer.ok ? "" : await answer.text();
      note.style.display = note.textContent ? "block" : "none";
    }, 1000);
  };

  // A context that draws nothing, with the answers that three.js needs to start.
  const nothing = (canvas) => {
    const constants = window.WebGL2RenderingContext?.prototype ?? {};
    const answers = {
      getContextAttributes: () => ({}), getExtension: () => null, getSupportedExtensions: () => [],
      getParameter: (name) => ({
        [constants.VERSION]: "WebGL 2.0", [constants.SHADING_LANGUAGE_VERSION]: "WebGL GLSL ES 3.00",
        [constants.VENDOR]: "none", [constants.RENDERER]: "none",
        [constants.SCISSOR_BOX]: [0, 0, 1, 1], [constants.VIEWPORT]: [0, 0, 1, 1],
      })[name] ?? 4096,
      getShaderPrecisionFormat: () => ({ precision: 23, rangeMin: 127, rangeMax: 127 }),
      getProgramParameter: (_, name) => name === constants.LINK_STATUS ? true : 0,
      getShaderParameter: () => true, isContextLost: () => false, getError: () => 0,
      getProgramInfoLog: () => "", getShaderInfoLog: () => "",
      checkFramebufferStatus: () => constants.FRAMEBUFFER_COMPLETE,
    };
    return new Proxy({ canvas, drawingBufferWidth: 1, drawingBufferHeight: 1 }, {
      get: (given, name) => given[name] ?? answers[name] ??
        (typeof name === "symbol" ? undefined : name === name.toUpperCase() ? constants[name] : () => ({})),
    });
  };

  // The robot from the side, from the front and from above, of the lines in the newest message.
  const draw = () => {
    const canvas = add("canvas", "position:fixed;left:0;top:0;pointer-events:none;z-index:50");
    canvas.id = "poise-drawing";
    const pen = canvas.getContext("2d");
    const paint = () => {
      const panel = document.querySelector(".poise-drawing"), state = panel?.dataset.state;
      canvas.width = innerWidth > 700 ? innerWidth - 350 : innerWidth; // beside the controls
      canvas.height = innerHeight;
      pen.font = "14px sans-serif";
      pen.fillText("This browser has no GPU: drawn in two dimensions." + (state ? "" : " Waiting for the robot."), 20, 30);
      if (!state) return;
      const { base: [x, y, floor], yaw, lines } = JSON.parse(state);
      const size = Math.min(canvas.width / 3 / 1.1, (canvas.height - 60) / 2.2); // pixels of a metre
      const forward = [Math.cos(yaw), Math.sin(yaw), 0], left = [-Math.sin(yaw), Math.cos(yaw), 0], up = [0, 0, 1];
      Object.entries({ side: [forward, up], front: [left, up], above: [forward, left] }).forEach(([name, axes], view) => {
        const centre = (view + 0.5) * canvas.width / 3, ground = canvas.height / 2 + (view === 2 ? 0 : size);
        const along = (axis, p) => axis[0] * (p[0] - x) + axis[1] * (p[1] - y) + axis[2] * (p[2] - floor);
        const at = (p) => [centre + size * along(axes[0], p), ground - size * along(axes[1], p)];
        pen.fillText(name, centre - 15, canvas.height / 2 + 1.15 * size);
        pen.lineCap = "round";
        if (view < 2) pen.fillRect(centre - 0.5 * size, ground, 1 * size, 1);
        for (const line of lines) {
          pen.strokeStyle = `rgb(${line.slice(7)})`;
          pen.lineWidth = line[6];
          pen.beginPath();
          pen.moveTo(...at(line));
          const [right, down] = at(line.slice(3));
          pen.lineTo(right + 0.1, down); // a dot has no length
          pen.stroke();
        }
      });
    };
    setInterval(paint, 100);
  };

  const probe = document.createElement("canvas").getContext("webgl2");
  const info = probe?.getExtension("WEBGL_debug_renderer_info");
  const renderer = probe?.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : probe.RENDERER);
  const software = /swiftshader|llvmpipe|softpipe|software/i.test(renderer) && !location.search.includes("3d=1");
  probe?.getExtension("WEBGL_lose_context")?.loseContext();
  if (!probe || software) {
    addEventListener("DOMContentLoaded", draw);
    const original = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
      return kind.startsWith("webgl") ? (this.poiseNothing ??= nothing(this)) : original.call(this, kind, ...rest);
    };
  }
  addEventListener("DOMContentLoaded", watch);
})();
