/** The page of an address that there is none at. */

import { startPage, titled } from "./header.js";
import { word } from "./words.js";

await startPage();
titled(word("missing.title"));
