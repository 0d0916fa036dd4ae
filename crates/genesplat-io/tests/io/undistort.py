"""Undistorts a photo with COLMAP, once for each camera that it is given; pinholes go to standard output as JSON.

A camera whose model this COLMAP does not know gets null.
"""

import json
import sys

import pycolmap

request = json.loads(sys.argv[1])
photo = pycolmap.Bitmap.read(request["photo"], True)
pinholes = []
for model, parameters in request["cameras"]:
    try:
        taken = pycolmap.Camera(model=model, width=photo.width, height=photo.height, params=parameters)
    except Exception:
        pinholes.append(None)
        continue
    picture, pinhole = pycolmap.undistort_image(pycolmap.UndistortCameraOptions(), photo, taken)
    picture.write(f"{request['out']}/{model}.png")
    pinholes.append({"size": [pinhole.width, pinhole.height], "params": pinhole.params.tolist()})
print(json.dumps(pinholes))
