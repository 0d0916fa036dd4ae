// Reads a splat with three.js and prints its attributes as JSON: node read_with_three.mjs FOLDER_OF_THREE FILE
import { readFile } from 'node:fs/promises';
import { extname, join } from 'node:path';
import { pathToFileURL } from 'node:url';

const [three, file] = process.argv.slice(2);
const LOADERS = { '.glb': 'GLTFLoader', '.spz': 'SPZLoader', '.splat': 'SPLATLoader' };

const name = LOADERS[extname(file)];
const loaders = await import(pathToFileURL(join(three, 'examples/jsm/loaders', `${name}.js`)).href);
const bytes = await readFile(file);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const loader = new loaders[name]();

let geometry;
if (name === 'GLTFLoader') {
    const { scene } = await loader.parseAsync(buffer, '');
    scene.traverse((object) => { geometry ??= object.geometry; });
} else {
    geometry = await loader.parse(buffer);
}

const attributes = Object.entries(geometry.attributes).map(([key, attribute]) => [key, Array.from(attribute.array)]);
console.log(JSON.stringify({ count: geometry.attributes.position.count, attributes: Object.fromEntries(attributes) }));
