// A reloaded page has no token in its address, but this tab may have stored one. It is tried once; the page stores it
// again if it is valid.
const KEY = "rangehound-token";
const token = sessionStorage.getItem(KEY);
sessionStorage.removeItem(KEY);
if (token) location.replace(`/?token=${encodeURIComponent(token)}`);
