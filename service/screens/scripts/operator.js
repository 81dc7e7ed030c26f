/** The operator's page. */

import { mountHeader } from "./header.js";
import { loadWords } from "./words.js";

await loadWords();
mountHeader("/");
