// The API reader: Swagger UI on our own contract, with the key of this tab.

import { keyHeader, showKey } from './key.js';

function send(request) {
  if (new URL(request.url, location.href).origin === location.origin) request.headers = { ...keyHeader(), ...request.headers };
  return request;
}

// the script of the reader is deferred and so is a module: it has run once this one does
window.SwaggerUIBundle({
  url: '/openapi.json',
  dom_id: '#reader',
  deepLinking: true,
  docExpansion: 'list',
  defaultModelsExpandDepth: 0,
  displayRequestDuration: true,
  // no validator: it is a service of another host
  validatorUrl: null,
  requestInterceptor: send,
});
showKey();

// the reader has a dark sheet of its own, behind a class
const dark = matchMedia('(prefers-color-scheme: dark)');
const follow = () => document.documentElement.classList.toggle('dark-mode', dark.matches);
dark.addEventListener('change', follow);
follow();
