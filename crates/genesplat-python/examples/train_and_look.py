"""Train a scene, look at it on the way, and save it: python train_and_look.py SCENE [ITERATIONS]."""

import sys

import genesplat as gs

scene = gs.Scene.load(sys.argv[1])
iterations = int(sys.argv[2]) if len(sys.argv) > 2 else 2000
trainer = gs.Trainer(scene, iterations=iterations)
for step in trainer:
    if step.iteration % (iterations // 5) == 0:
        scores = trainer.evaluate()
        print(f"{step.iteration}: loss {step.loss:.3f}, {step.gaussians} Gaussians, {scores.psnr:.2f} dB")

trainer.save("scene.spz")
with open("scene.html", "w", encoding="utf-8") as page:
    page.write(trainer.splats.to_html(scene.name))
