// A page that is loaded again has no token in its address, but this tab had one. It is tried once: the page keeps it
// again if it was right.
const KEY = "rangehound-token";
const token = sessionStorage.getItem(KEY);
sessionStorage.removeItem(KEY);
if (token) location.replace(`/?token=${encodeURIComponent(token)}`);
