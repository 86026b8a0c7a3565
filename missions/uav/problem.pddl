; Seven samples are wanted from the beginning; whether one is, is sensed, so the goal may grow.
(define (problem analyse_the_samples)
  (:domain uav)

  (:objects
    search_for_samples pick_up_and_analyse analyse_on_site return_and_recharge
    land_and_fold_gripper - action
    sample_1 sample_2 sample_3 sample_4 sample_5 sample_6 sample_7 sample_8 - sample
    drone - robot
  )

  (:init
    (search_for_samples_action search_for_samples)
    (pick_up_and_analyse_action pick_up_and_analyse)
    (analyse_on_site_action analyse_on_site)
    (return_and_recharge_action return_and_recharge)
    (land_and_fold_gripper_action land_and_fold_gripper)
    (looking drone)
    (gripper_folded drone)
    (wanted sample_1) (wanted sample_2) (wanted sample_3) (wanted sample_4)
    (wanted sample_5) (wanted sample_6) (wanted sample_7)
  )

  (:goal (forall (?s - sample) (imply (wanted ?s) (analysed ?s))))

  (:metric minimize (total-cost))
)
